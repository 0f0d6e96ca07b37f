"""Settings saved by an earlier version, completed with the values that reproduce what was flown then.

Only keys that decide about an episode matter here. The others (how a policy was trained, where a run was executed) take
today's values; a key that matters and whose earlier value nobody wrote down makes a record too old to be flown again.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any

from formctl.store.files import StoreError

FLOWN = ("scenario", "drone", "observation", "eval")
"""Groups that an episode depends on, with ``sim``, ``deploy`` and the baseline, which are never completed."""

REPRODUCES: dict[str, Any] = {
    "drone.latency": 0.0,  # commands took effect at once
    "eval.compile": False,
    "observation.lookahead": 0.0,  # balls were shown where they are
    "observation.slot_relative": False,  # other drones were shown where they are
    "observation.rotor_throttles": False,
    "observation.previous_command": False,
}
"""Keys that were added later, and the value under which the world is what it was before."""


def complete(tree: Mapping[str, Any], where: object = "the settings") -> dict[str, Any]:
    """``config.yaml`` of any version as today's settings. Raises StoreError naming the keys it is too old for."""
    today = _today()
    done: dict[str, Any] = {}
    missing: list[str] = []
    for name, default in today.items():
        given = tree.get(name)
        if name in FLOWN:
            done[name] = _merged(name, given or {}, default, missing)
        elif name in ("deploy", "baseline") or not isinstance(default, Mapping):
            done[name] = given if name in tree else default
        else:
            done[name] = default
    if missing:
        raise StoreError(f"{where} is too old to be flown again: it does not say {', '.join(missing[:3])}")
    return done | {"survey": None}


def filled(tree: Mapping[str, Any], asked: Mapping[str, Any]) -> dict[str, Any]:
    """Settings recorded earlier with those keys of ``asked`` that came later and whose earlier value is known."""
    done = dict(tree)
    for dotted, value in REPRODUCES.items():
        group, _, key = dotted.partition(".")
        if key in (asked.get(group) or {}) and key not in (done.get(group) or {key}):
            done[group] = {**done[group], key: value}
    return done


def _merged(group: str, given: Mapping[str, Any], default: Mapping[str, Any], missing: list[str]) -> dict[str, Any]:
    """The group with its later keys; those without a known value are added to ``missing``."""
    merged = dict(given)
    for key in default:
        if key not in merged:
            dotted = f"{group}.{key}"
            if dotted in REPRODUCES:
                merged[key] = REPRODUCES[dotted]
            else:
                missing.append(dotted)
    return merged


@cache
def _today() -> dict[str, Any]:
    from formctl.settings import compose

    return compose([]).tree
