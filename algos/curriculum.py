"""Curricula: periods of one training, each with its share of the budget and its changes to the scenario."""

import difflib
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from envs.spec import ScenarioSpec

SAMPLED = {
    "name",
    "columns",
    "column_layout",
    "column_cell",
    "column_half_width",
    "balls",
    "ball_aim",
    "throw_time",
    "ball_speed",
    "time_to_hit",
    "release_height",
    "position_jitter",
    "attitude_jitter",
}
"""Scenario fields that only decide what is drawn: periods that differ in nothing else share one (compiled) world."""


@dataclass(frozen=True)
class Period:
    """One period: `scenario` overrides fields of the configured scenario; everything else follows the command line."""

    name: str
    share: float  # of the steps, relative to the other periods
    scenario: dict[str, Any]
    start: Literal["previous", "scratch"]  # whose weights it starts from


@dataclass(frozen=True)
class CurriculumSpec:
    """The periods in the order they are trained (`conf/curriculum/`; paper, Sec. IV-B2)."""

    name: str
    periods: tuple[Period, ...]


@dataclass(frozen=True)
class Stage:
    """A period put on a budget: updates first <= k < last, in one scenario."""

    period: Period
    scenario: ScenarioSpec
    first: int
    last: int


def plan(spec: CurriculumSpec, scenario: ScenarioSpec, steps: int, steps_per_update: int) -> tuple[Stage, ...]:
    """The periods of `spec` as stages over whole updates.

    The total is rounded down to whole updates as in the release, and is the same for every curriculum, so that
    curricula are compared at equal data. Raises ValueError for a budget of less than one update per period, shares
    that are not positive, and overrides that are no scenario fields.
    """
    if not spec.periods:
        raise ValueError(f"curriculum={spec.name} has no periods: give it at least one")
    for period in spec.periods:
        if not period.share > 0:
            raise ValueError(f"curriculum period {period.name!r}: share={period.share} has to be positive")
    updates = steps // steps_per_update
    if updates < len(spec.periods):
        raise ValueError(
            f"{steps} steps are less than one update ({steps_per_update} steps) for each of the {len(spec.periods)} "
            f"periods of curriculum={spec.name}: raise train.steps or lower algo.envs"
        )
    stages: list[Stage] = []
    total = sum(period.share for period in spec.periods)
    passed, first = 0.0, 0
    for index, period in enumerate(spec.periods):
        passed += period.share
        left = len(spec.periods) - 1 - index  # each later period keeps at least one update
        last = min(max(round(updates * passed / total), first + 1), updates - left)
        stages.append(Stage(period, period_scenario(scenario, period), first, last))
        first = last
    return tuple(stages)


def period_scenario(scenario: ScenarioSpec, period: Period) -> ScenarioSpec:
    """The configured scenario with the period's overrides, checked. Raises ValueError naming the field."""
    known = [field.name for field in fields(ScenarioSpec)]
    for key in period.scenario:
        if key not in known:
            near = difflib.get_close_matches(key, known, 1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; the fields are {', '.join(known)}"
            raise ValueError(f"curriculum period {period.name!r}: the scenario has no field {key!r}{hint}")
    try:
        return TypeAdapter(ScenarioSpec).validate_python({**asdict(scenario), **period.scenario})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = str(first["loc"][0])
        raise ValueError(
            f"curriculum period {period.name!r}: scenario {key}={period.scenario.get(key)!r}: {first['msg']}"
        ) from error


def capacity(stages: tuple[Stage, ...]) -> tuple[int, int]:
    """Most columns and most balls of any stage: the shape all of them are padded to."""
    return max(stage.scenario.columns for stage in stages), max(stage.scenario.balls for stage in stages)


def same_world(one: ScenarioSpec, other: ScenarioSpec) -> bool:
    """Whether two scenarios differ only in what is drawn, so that one world serves both."""
    left, right = asdict(one), asdict(other)
    return all(left[key] == right[key] for key in left if key not in SAMPLED)
