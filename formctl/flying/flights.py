"""Flights of methods that think for one episode at a time: in worker processes, kept as they finish.

Every finished episode is a line of ``flown.jsonl`` in the run's folder until the table of all of them is written: an
evaluation that was killed goes on with the episodes that are missing. A row is the same whoever flew it and when.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from algos.compilation import Compiler
from envs import flight
from envs.formation import FormationEnv, WorldSpec
from envs.metrics import EvalSpec
from envs.scenarios import select
from envs.spec import Scenarios
from formctl.engines import workers
from formctl.errors import RunFailed
from formctl.settings.build import environment, linked
from formctl.store.files import append_line, plain, read_lines

if TYPE_CHECKING:
    import pandas as pd

    from baselines.protocol import Agent
    from envs.deployment import DeploySpec

FLOCK = 25
"""Episodes of planners that one process flies side by side at most: what is lost when it is killed."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Craft:
    """A method in a world; picklable, and made anew in every worker."""

    make: "Callable[[FormationEnv], Agent]"
    world: WorldSpec
    sim: str
    evaluation: EvalSpec
    deploy: "DeploySpec | None" = None

    @cached_property
    def env(self) -> FormationEnv:
        """The world."""
        return environment(self.world, self.sim, self.deploy)

    def fly(self, agent: "Agent", scenarios: Scenarios) -> Row:
        """The metric columns of all episodes, one entry per episode."""
        flown = linked(agent, self.env, self.deploy)
        flown.reset(scenarios, self.env.reset(scenarios))
        return flight.fly(self.env, flown.act, scenarios, self.evaluation)


class Pilot(Craft):
    """Flies a few episodes side by side, each with an agent of its own."""

    def __call__(self, scenarios: Scenarios) -> list[Row]:
        """The metric columns of every episode as JSON types."""
        agents = [self.make(self.env) for _ in scenarios.id]
        flown = self.fly(together(agents), scenarios)
        return [
            plain({name: values[number] for name, values in flown.items()}) | troubles(agent)
            for number, agent in enumerate(agents)
        ]


class Squadron(Craft):
    """Flies batches of episodes with one agent for all of them, compiled where the evaluation says so.

    A deployment is never compiled: rounding grows into another flight (``envs.deployment.Link``), and its rows are to
    be what the same commands give anywhere else in the program.
    """

    @property
    def compiles(self) -> bool:
        """Whether to compile."""
        return self.evaluation.compile and self.deploy is None

    @cached_property
    def env(self) -> FormationEnv:
        """The world."""
        return environment(self.world, self.sim, self.deploy).compiled(Compiler(self.compiles))

    @cached_property
    def agent(self) -> "Agent":
        """Who flies one batch after another."""
        return self.make(self.env)

    def __call__(self, scenarios: Scenarios) -> Row:
        """The metric columns of a batch, one entry per episode."""
        episodes = len(scenarios.id)
        if self.compiles:  # for batches of one size; a shorter one is filled up
            scenarios = select(scenarios, torch.arange(self.evaluation.batch) % episodes)
        return {name: column[:episodes] for name, column in self.fly(self.agent, scenarios).items()}


def together(agents: "list[Agent]") -> "Agent":
    """One agent for an episode of each of ``agents``. ValueError for several that cannot fly side by side."""
    from baselines.planner.agent import PlannerAgent
    from baselines.planner.flock import Flock

    if len(agents) == 1:
        return agents[0]
    planners = [agent for agent in agents if isinstance(agent, PlannerAgent)]
    if len(planners) < len(agents):
        raise ValueError(f"{agents[0].name} flies one episode at a time, not {len(agents)}")
    return Flock(planners)


def flock(agent: "Agent", episodes: int, jobs: int) -> int:
    """How many episodes to fly side by side with agents like this one, so that ``jobs`` processes have work."""
    from baselines.planner.agent import PlannerAgent

    return min(FLOCK, math.ceil(episodes / jobs)) if isinstance(agent, PlannerAgent) else 1


def troubles(agent: "Agent") -> Row:
    """Columns ``planner_failures`` and ``planner_reason`` of the episode just flown: how many, and the commonest."""
    from baselines.protocol import Fallible

    reasons = [failure.reason for failure in agent.failures] if isinstance(agent, Fallible) else []
    commonest = Counter(reasons).most_common(1)  # of equally common ones the first
    return {"planner_failures": len(reasons), "planner_reason": commonest[0][0] if commonest else ""}


@dataclass(frozen=True)
class Journal:
    """Episodes that are flown already, by their number; without a path nothing is kept."""

    path: Path | None

    def read(self) -> dict[int, Row]:
        """Rows by number of the flight."""
        return {} if self.path is None else {line["flight"]: line["row"] for line in read_lines(self.path)}

    def add(self, number: int, row: Row) -> None:
        """Keep a row."""
        if self.path is not None:
            append_line(self.path, {"flight": number, "row": row})

    def remove(self) -> None:
        """The rows stand elsewhere now."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def fly(
    pilot: Pilot,
    episodes: Sequence[Scenarios],
    jobs: int,
    journal: Journal,
    listen: Callable[[int], None],
    party: int = 1,
) -> "pd.DataFrame":
    """Rows of ``episodes`` in their order, flown by ``jobs`` processes; those in the journal are not flown again.

    A process flies ``party`` of them side by side. ``listen`` hears how many are done.
    Raises RunFailed when a worker process dies.
    """
    rows = {number: row for number, row in journal.read().items() if number < len(episodes)}
    listen(len(rows))
    parties = list(divided(episodes, [number for number in range(len(episodes)) if number not in rows], party))
    requests = [side_by_side([episodes[number] for number in numbers]) for numbers in parties]
    try:
        for index, found in workers.share(pilot, requests, jobs):
            for number, row in zip(parties[index], found, strict=True):
                journal.add(number, row)
                rows[number] = row
            listen(len(rows))
    except workers.WorkerLost as lost:
        kept = f"{len(rows)} of {len(episodes)} episodes are kept: the same command again goes on from there"
        raise RunFailed(f"{lost}; {kept if journal.path else 'no episode was kept'}") from lost
    return table([rows[number] for number in range(len(episodes))])


def divided(episodes: Sequence[Scenarios], numbers: Sequence[int], party: int) -> Iterator[list[int]]:
    """``numbers`` of episodes, at most ``party`` at a time, those together that are of the same shape."""
    for _, alike in groupby(numbers, key=lambda number: [field.shape for field in episodes[number]]):
        same = list(alike)
        yield from (same[first : first + party] for first in range(0, len(same), party))


def side_by_side(drawn: Sequence[Scenarios]) -> Scenarios:
    """All episodes in one batch; their fields have the same shapes."""
    return Scenarios(*(torch.cat(fields) for fields in zip(*drawn, strict=True)))


def table(rows: Sequence[Row]) -> "pd.DataFrame":
    """Rows of JSON types as columns; only numbers that are not finite are null."""
    import pandas as pd  # workers do without

    missing = float("nan")
    return pd.DataFrame([{name: missing if value is None else value for name, value in row.items()} for row in rows])
