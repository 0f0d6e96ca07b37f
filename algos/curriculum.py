"""Curricula: periods of one training, each with its share of the budget and its changes to the task and the learner."""

import difflib
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from pydantic import TypeAdapter, ValidationError

from algos.learner import LearnerSpec
from algos.statistics import KEYS, met
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

ENOUGH = {"episodes": 100.0}
"""Finished episodes that `advance_when` waits for, unless it names another number of `episodes` itself."""


@dataclass(frozen=True)
class Period:
    """One period: `scenario` overrides fields of the configured scenario; everything else follows the command line.

    The last four may be left out: an entry of a list has no other file to take them from.
    """

    name: str
    share: float  # of the steps, relative to the other periods; the most it takes where it may end early
    scenario: dict[str, Any]
    start: Literal["previous", "scratch"]  # whose weights it starts from
    algo: Any = None  # settings of its learner, a LearnerSpec; None: the configured one
    reward: Any = None  # an envs.reward.Reward; None: the configured one
    advance_when: dict[str, float] | None = None  # training statistics that end it early, all of them reached
    ramp: dict[str, tuple[Any, ...]] | None = None  # scenario fields that change while it lasts, first to last value


@dataclass(frozen=True)
class CurriculumSpec:
    """The periods in the order they are trained (`conf/curriculum/`; paper, Sec. V-B2)."""

    name: str
    periods: tuple[Period, ...]


@dataclass(frozen=True)
class Stage:
    """A period put on a budget: `updates` of its learner, the first of them after `first` environment steps."""

    period: Period
    scenario: ScenarioSpec  # at the end of the period
    algo: LearnerSpec
    first: int  # environment steps done when it begins
    updates: int

    @property
    def size(self) -> int:
        """Environment steps of one update."""
        return self.algo.envs * self.algo.rollout

    @property
    def last(self) -> int:
        """Environment steps done when it is over."""
        return self.first + self.updates * self.size

    @property
    def draws(self) -> int:
        """How many pools of scenarios are drawn while it lasts."""
        return math.ceil(self.updates / self.algo.pool_updates)

    def law(self, draw: int) -> ScenarioSpec:
        """What the pool of number `draw` is drawn from: a ramp's first pool has its first values, the last its last."""
        return period_scenario(self.scenario, self.period, draw / max(self.draws - 1, 1))

    def facts(self, draw: int) -> dict[str, float]:
        """`period/<field>` for every ramped field: its number, or the place of its value in the ramp."""
        law = self.law(draw)
        now = {key: (getattr(law, key), values) for key, values in (self.period.ramp or {}).items()}
        return {f"period/{key}": float(x) if _number(x) else _place(x, values) for key, (x, values) in now.items()}

    def over(self, draw: int, metrics: dict[str, float]) -> bool:
        """Whether the period has reached what it is for. A ramp is always flown to its last values first."""
        rule = self.period.advance_when
        if rule is None or (self.period.ramp and draw < self.draws - 1):
            return False
        return met(metrics, ENOUGH | rule)


def plan(spec: CurriculumSpec, scenario: ScenarioSpec, algo: LearnerSpec, steps: int) -> tuple[Stage, ...]:
    """The periods of `spec` as stages over whole updates.

    The total is rounded down to whole updates as in the release, and is the same for every curriculum with one
    learner, so that curricula are compared at equal data. Raises ValueError for a budget of less than one update per
    period, shares that are not positive, and overrides, ramps or rules of fields that do not exist.
    """
    if not spec.periods:
        raise ValueError(f"curriculum={spec.name} has no periods: give it at least one")
    for period in spec.periods:
        _check(period)
    stages = [Stage(period, period_scenario(scenario, period), period.algo or algo, 0, 1) for period in spec.periods]
    if sum(stage.size for stage in stages) > steps:
        sizes = " + ".join(str(size) for size in sorted({stage.size for stage in stages}))
        raise ValueError(
            f"{steps} steps are less than one update ({sizes} steps) for each of the {len(spec.periods)} "
            f"periods of curriculum={spec.name}: raise train.steps or lower algo.envs"
        )
    return _divide(stages, 0, steps)


def advance(stages: tuple[Stage, ...], index: int, done: int, steps: int) -> tuple[Stage, ...]:
    """The plan after stage `index` has ended early, at `done` of `steps`: the others share what it leaves."""
    ended = replace(stages[index], updates=(done - stages[index].first) // stages[index].size)
    later = stages[index + 1 :]
    return (*stages[:index], ended, *(_divide(later, done, steps) if later else ()))


def _divide(stages: Sequence[Stage], begin: int, steps: int) -> tuple[Stage, ...]:
    """The stages one after the other on the environment steps from `begin` to `steps`, by their shares."""
    whole = (steps - begin) // stages[-1].size * stages[-1].size
    total = sum(stage.period.share for stage in stages)
    placed: list[Stage] = []
    passed, first = 0.0, begin
    for index, stage in enumerate(stages):
        passed += stage.period.share
        kept = sum(later.size for later in stages[index + 1 :])  # each later period keeps at least one update
        most = (steps - kept - first) // stage.size
        wanted = round((begin + whole * passed / total - first) / stage.size)
        updates = min(max(wanted, 1), most) if index + 1 < len(stages) else most
        placed.append(replace(stage, first=first, updates=updates))
        first = placed[-1].last
    return tuple(placed)


def period_scenario(scenario: ScenarioSpec, period: Period, share: float = 1.0) -> ScenarioSpec:
    """The configured scenario with the period's overrides, its ramps at `share` of their way, checked.

    Raises ValueError naming the field.
    """
    changes = period.scenario | {key: between(values, share) for key, values in (period.ramp or {}).items()}
    known = [field.name for field in fields(ScenarioSpec)]
    for key in changes:
        if key not in known:
            raise ValueError(f"curriculum period {period.name!r}: the scenario has no field {key!r}{_hint(key, known)}")
    try:
        return TypeAdapter(ScenarioSpec).validate_python({**asdict(scenario), **changes})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = str(first["loc"][0])
        raise ValueError(
            f"curriculum period {period.name!r}: scenario {key}={changes.get(key)!r}: {first['msg']}"
        ) from error


def between(values: Sequence[Any], share: float) -> Any:
    """A ramp at `share` of its way: numbers are joined by straight lines, other values take turns.

    Whole numbers stay whole.
    """
    if all(_number(value) for value in values):
        now = float(np.interp(share, np.linspace(0, 1, len(values)), values))
        return round(now) if all(isinstance(value, int) for value in values) else now
    return values[min(int(share * len(values)), len(values) - 1)]


def capacity(stages: tuple[Stage, ...]) -> tuple[int, int]:
    """Most columns and most balls of any stage: the shape all of them are padded to."""

    def most(key: str) -> int:
        ramps = [(stage.period.ramp or {}).get(key, ()) for stage in stages]
        return max(*(getattr(stage.scenario, key) for stage in stages), *(n for ramp in ramps for n in ramp), 0)

    return most("columns"), most("balls")


def same_world(one: ScenarioSpec, other: ScenarioSpec) -> bool:
    """Whether two scenarios differ only in what is drawn, so that one world serves both."""
    left, right = asdict(one), asdict(other)
    return all(left[key] == right[key] for key in left if key not in SAMPLED)


def _check(period: Period) -> None:
    """Raise ValueError for a share, a ramp or a rule that cannot be used."""
    where = f"curriculum period {period.name!r}"
    if not period.share > 0:
        raise ValueError(f"{where}: share={period.share} has to be positive")
    for key, values in (period.ramp or {}).items():
        if key not in SAMPLED:
            raise ValueError(f"{where}: ramp of {key!r}{_hint(key, sorted(SAMPLED - {'name'}))}")
        if len(values) < 2:
            raise ValueError(f"{where}: ramp of {key!r} needs a first and a last value")
    for key in period.advance_when or {}:
        if key not in (*KEYS, "episodes"):
            raise ValueError(f"{where}: advance_when knows no statistic {key!r}{_hint(key, [*KEYS, 'episodes'])}")


def _hint(key: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(key, known, 1)
    return f"; did you mean {near[0]!r}?" if near else f"; the fields are {', '.join(known)}"


def _number(value: Any) -> bool:
    return isinstance(value, int | float)


def _place(value: Any, values: Sequence[Any]) -> float:
    return float([tuple(x) if isinstance(x, list) else x for x in values].index(value))
