"""Plain values into the frozen dataclasses of the groups, strictly; what does not fit is explained in one line."""

import json
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from pydantic import ConfigDict, TypeAdapter, ValidationError
from scipy.spatial.distance import pdist
from torch import float64

from algos.curriculum import period_scenario
from envs.scenarios import capacity
from envs.shapes import slots
from formctl import store
from formctl.errors import ConfigError
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from algos.curriculum import CurriculumSpec
    from envs.spec import ScenarioSpec
    from envs.vocabulary import Weights


MOVED = {
    "formctl.spec.LocalSpec": "formctl.engines.workers.LocalSpec",
    "formctl.spec.RaySpec": "formctl.engines.cluster.RaySpec",
    "formctl.settings.schema.LocalSpec": "formctl.engines.workers.LocalSpec",
    "formctl.settings.schema.RaySpec": "formctl.engines.cluster.RaySpec",
    "formctl.spec.": "formctl.settings.schema.",
}
"""Where ``target`` of an earlier version's config.yaml is found today, by its beginning."""


def read(group: str, values: dict[str, Any], dotted: str | None = None) -> Any:
    """The dataclass of a group; ``target`` among the values names it, otherwise ``dotted``. Raises ConfigError."""
    spec = _load(group, values.get("target", dotted))
    named = {field.name for field in fields(spec)}
    return read_as(spec, group, {key: value for key, value in values.items() if key != "target" or key in named})


def keys(group: str, dotted: str | None) -> set[str]:
    """The keys that the dataclass ``dotted`` of a group has. Raises ConfigError."""
    return {field.name for field in fields(_load(group, dotted))}


def read_as(spec: Any, group: str, values: dict[str, Any]) -> Any:
    """``values`` as the dataclass ``spec``: no key too many, none missing, no type bent. Raises ConfigError."""
    try:
        return _adapter(spec).validate_json(json.dumps([_whole(values)]))[0]
    except ValidationError as error:
        raise _explain(group, error) from error


def plain(spec: object) -> dict[str, Any]:
    """A dataclass as plain data, the inverse of ``read_as``."""
    kind: Any = type(spec)
    values = _adapter(kind).dump_python((spec,), mode="json")[0]
    assert isinstance(values, dict)
    return values


def check_weights(weights: "Weights") -> None:
    """Raise ConfigError unless the four sum to 1; that none is negative their types have told."""
    if abs(sum(weights) - 1) > 1e-6:
        raise ConfigError(
            f"the weights {', '.join(f'{weight:g}' for weight in weights)} sum to {sum(weights):g}, not to 1: "
            "set all four (weights.formation= weights.flight= weights.obstacle= weights.action=)"
        )


def check_name(name: str) -> None:
    """Raise ConfigError where ``name`` cannot name a run's folder."""
    try:
        store.check_name(name)
    except StoreError as error:
        raise ConfigError(str(error)) from error


def check_scenario(key: str, scenario: "ScenarioSpec") -> None:
    """Raise ConfigError for a formation that does not exist and for more columns than places."""
    try:
        places = slots(scenario, float64)
    except ValueError as error:
        raise ConfigError(f"{key}: {error}") from error
    if len(places) > 1 and float(pdist(places.numpy()).min()) <= scenario.hit_radius:
        raise ConfigError(
            f"{key}.formation puts two drones {pdist(places.numpy()).min():g} m apart; "
            f"within {scenario.hit_radius:g} m (hit_radius) they collide at the start"
        )
    room = capacity(scenario)
    if not 0 <= scenario.columns <= room:
        raise ConfigError(
            f"{key}.columns={scenario.columns}: the {scenario.column_layout} layout has {room} places for columns"
        )
    if scenario.balls < 0:
        raise ConfigError(f"{key}.balls={scenario.balls}: there cannot be less than none")


def check_curriculum(curriculum: "CurriculumSpec", scenario: "ScenarioSpec") -> None:
    """Raise ConfigError for a period whose changes do not make a scenario."""
    for period in curriculum.periods:
        for share in (0.0, 1.0):  # of its ramps
            try:
                changed = period_scenario(scenario, period, share)
            except ValueError as error:
                raise ConfigError(str(error)) from error
            check_scenario(f"curriculum period {period.name!r}: scenario", changed)


@cache
def _adapter(spec: Any) -> TypeAdapter[tuple[Any]]:
    """The one-tuple carries the settings, which a bare dataclass could not, to the dataclass and those inside it."""
    return TypeAdapter(tuple[spec], config=ConfigDict(extra="forbid", strict=True, allow_inf_nan=False))


def _whole(value: Any) -> Any:
    """1e6 is a whole number to whoever types it."""
    if isinstance(value, dict):
        return {key: _whole(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_whole(item) for item in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _explain(group: str, error: ValidationError) -> ConfigError:
    first = error.errors(include_url=False)[0]
    if first["type"] == "value_error":  # raised by the dataclass itself, which names its keys
        return ConfigError(first["msg"].removeprefix("Value error, "))
    given = json.dumps(first["input"], ensure_ascii=False)
    steps = [str(step) for step in first["loc"][1:]]
    key = ".".join([*([group] if group else []), *(step for step in steps if not _of_union(step))])
    if first["type"] == "missing" and isinstance(first["loc"][-1], int):
        key = key.rpartition(".")[0]
        return ConfigError(
            f"{key}={json.dumps(first['input'], ensure_ascii=False)} cannot be used: it should have more values"
        )
    if first["type"] == "missing":
        return ConfigError(f"{key} is missing: set it with {key}=VALUE")
    if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        return ConfigError(f"unknown key {key!r}; formctl conf keys lists them all")
    message = first["msg"]
    for word, better in (("Input", "it"), ("Tuple", "it"), ("array", "list"), (" after validation", "")):
        message = message.replace(word, better)
    return ConfigError(f"{key}={given} cannot be used: {message}")


def _of_union(step: str) -> bool:
    """Whether a step on the way to an error names a kind of value, not a key."""
    return step in ("str", "int", "constrained-int") or "[" in step


def _load(group: str, dotted: str | None) -> Any:
    for before, today in MOVED.items():
        dotted = today + dotted.removeprefix(before) if dotted and dotted.startswith(before) else dotted
    module, _, name = (dotted or "").rpartition(".")
    try:
        spec = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"{group}.target={dotted} cannot be imported ({error})") from error
    if not is_dataclass(spec):
        raise ConfigError(f"{group}.target={dotted} names no settings: it has to be a dataclass")
    return spec
