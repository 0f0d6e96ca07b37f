"""Baselines by name: each is one YAML file in ``conf/baseline/`` whose ``target`` names a class.

``target`` is a name in dots, or ``FILE.py:CLASS`` for a class in a file. The class takes (name, env, spec); ``spec`` is
a frozen dataclass, filled from the YAML's other keys and checked. One without settings takes (name, env).
Modules are imported when a baseline is made, not before.
"""

import hashlib
import sys
from collections.abc import Mapping
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from baselines.protocol import Agent, Capabilities
from envs.formation import FormationEnv

NOT_SETTINGS = ("target", "label", "role")
"""Keys of a YAML file that are about the method and not for its class."""


def make(name: str, env: FormationEnv, settings: Mapping[str, Any]) -> Agent:
    """The baseline of ``settings`` (the composed ``conf/baseline/<name>.yaml``) for ``env``.

    ValueError in one line for a target that cannot be imported or is no agent, for settings that do not fit it, and for
    a world that its capabilities do not fit.
    """
    target = settings.get("target", "")
    kind = _load(name, target)
    if reason := kind.capabilities.misfit(env):
        raise ValueError(f"baseline '{name}' {reason}")
    spec = _spec(name, kind, settings)
    agent: Agent = kind(name, env) if spec is None else kind(name, env, spec)
    return agent


def capabilities(name: str, settings: Mapping[str, Any]) -> Capabilities:
    """What the baseline of ``settings`` can do and needs. ValueError as in ``make``."""
    found: Capabilities = _load(name, settings.get("target", "")).capabilities
    return found


def training(name: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """What the method of ``settings`` says about its training, e.g. ``steps``; empty where it has learnt nothing."""
    kind = _load(name, settings.get("target", ""))
    if not hasattr(kind, "training"):
        return {}
    facts: dict[str, Any] = kind.training(_spec(name, kind, settings))
    return facts


def _load(name: str, target: str) -> Any:
    in_file = ".py:" in target
    place, _, attribute = target.rpartition(":" if in_file else ".")
    try:
        source = _from_file(Path(place)) if in_file else import_module(place)
        if not hasattr(source, attribute):
            raise AttributeError(f"{place} has no {attribute}")
        kind = getattr(source, attribute)
    except (ImportError, AttributeError, ValueError, SyntaxError, OSError) as error:
        raise ValueError(f"baseline '{name}': target '{target}' cannot be imported ({error})") from error
    if not (hasattr(kind, "act") and hasattr(kind, "reset") and hasattr(kind, "capabilities")):
        raise ValueError(f"baseline '{name}': target '{target}' is no agent: see baselines.protocol.Agent")
    return kind


def _from_file(path: Path) -> ModuleType:
    """The module in a file, imported once; a file that was changed is imported anew."""
    code = path.read_bytes()
    alias = f"formctl_file_{hashlib.sha256(str(path.resolve()).encode() + code).hexdigest()[:16]}"
    if alias not in sys.modules:
        found = spec_from_file_location(alias, path)
        if found is None or found.loader is None:
            raise ImportError(f"{path} is no Python file")
        module = module_from_spec(found)
        sys.modules[alias] = module  # dataclasses look their module up while it is being made
        try:
            found.loader.exec_module(module)
        except BaseException:
            del sys.modules[alias]
            raise
    return sys.modules[alias]


def _spec(name: str, kind: Any, settings: Mapping[str, Any]) -> Any:
    """``settings`` as the dataclass that ``kind`` takes, nested ones included; no key too many or too few.

    None for a class that takes no settings.
    """
    spec = get_type_hints(kind.__init__).get("spec")
    values = {key: value for key, value in settings.items() if key not in NOT_SETTINGS}
    if spec is None:
        if values:
            raise ValueError(f"baseline '{name}': baseline.{next(iter(values))}: it takes no settings")
        return None
    adapter = TypeAdapter(tuple[spec], config=ConfigDict(extra="forbid"))
    try:
        return adapter.validate_python((values,))[0]
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(("baseline", *(str(part) for part in first["loc"][1:])))
        raise ValueError(f"baseline '{name}': {key}: {first['msg']}") from error
