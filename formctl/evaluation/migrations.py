"""Settings saved by an earlier version, completed with the values that reproduce what was flown then.

Only keys that decide about an episode matter here. The others (how a policy was trained, where a run was executed) take
today's values; a key that matters and whose earlier value nobody wrote down makes a record too old to be flown again.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any

from formctl.settings import compose
from formctl.store.files import StoreError

FLOWN = ("scenario", "drone", "observation", "eval")
"""Groups that an episode depends on, with ``deploy``, and with ``sim`` and the baseline, which are never completed."""

REPRODUCES: dict[str, Any] = {
    "drone.latency": 0.0,  # commands took effect at once
    "drone.thrust_curve": [0.0, 1.0],  # thrust and torque grew with the square of rotor speed
    "drone.torque_curve": [0.0, 1.0],
    "drone.spin_up": [1.0, 0.0],  # first order
    "drone.spin_down": [1.0, 0.0],
    "drone.rotor_momentum": 0.0,
    "drone.rotor_radius": 0.0231,
    "drone.axial_damping": 0.0,
    "scenario.vehicle": {"mass": [1.0, 1.0], "thrust": [1.0, 1.0], "motor_lag": [1.0, 1.0]},
    "scenario.air": {"wind": [0.0, 0.0], "gusts": 1.0, "ground_effect": False},  # stood still
    "scenario.messages": {  # everybody knew everybody's state
        "period": 0.0,
        "delay": [0.0, 0.0],
        "jitter": 0.5,
        "loss": [0.0, 0.0],
        "burst": 3.0,
        "horizon": 2.0,
    },
    "observation.message_age": False,
    "deploy.wind": [0.0, 0.0],
    "deploy.gusts": 1.0,
    "deploy.ground_effect": False,
    "scenario.corridor": 1e6,  # m; planners planned as far aside as they liked
    "eval.speed_threshold": 1e6,  # m/s; speed and height satisfied whatever they were
    "eval.height_threshold": 1e6,  # m
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
        elif name == "deploy" and isinstance(given, Mapping):
            done[name] = _known("deploy") | dict(given)
        elif name in ("deploy", "baseline") or not isinstance(default, Mapping):
            done[name] = given if name in tree else default
        else:
            done[name] = default
    if missing:
        raise StoreError(f"{where} is too old to be flown again: it does not say {', '.join(missing[:3])}")
    return done | {"survey": None}


def _known(group: str) -> dict[str, Any]:
    """The later keys of a group with the values that reproduce what was flown before."""
    return {key.partition(".")[2]: value for key, value in REPRODUCES.items() if key.startswith(f"{group}.")}


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
    return compose([]).tree
