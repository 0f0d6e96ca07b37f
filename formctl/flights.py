"""Flights of methods that fly one episode at a time: side by side in worker processes, kept as they finish.

Every finished episode is a line of ``flown.jsonl`` in the run's folder until the table of all of them is written: an
evaluation that was killed goes on with the episodes that are missing. A row is the same whoever flew it and when.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from envs import flight
from envs.formation import FormationEnv, WorldSpec
from envs.metrics import EvalSpec
from envs.spec import Scenarios
from formctl import workers
from formctl.build import environment, linked
from formctl.errors import RunFailed
from formctl.files import append_line, plain, read_lines

if TYPE_CHECKING:
    import pandas as pd

    from baselines.protocol import Agent
    from envs.deployment import DeploySpec

Row = dict[str, Any]


@dataclass(frozen=True)
class Pilot:
    """Flies single episodes; picklable, and made anew in every worker."""

    make: "Callable[[FormationEnv], Agent]"
    world: WorldSpec
    sim: str
    evaluation: EvalSpec
    deploy: "DeploySpec | None" = None

    @cached_property
    def _cockpit(self) -> "tuple[FormationEnv, Agent, Agent]":
        """The world, the agent, and the agent as it flies there."""
        env = environment(self.world, self.sim, self.deploy)
        agent = self.make(env)
        return env, agent, linked(agent, env, self.deploy)

    def __call__(self, scenarios: Scenarios) -> Row:
        """The metric columns of one episode as JSON types."""
        env, agent, flown = self._cockpit
        flown.reset(scenarios, env.reset(scenarios))
        columns = flight.fly(env, flown.act, scenarios, self.evaluation)
        row: Row = plain({name: values[0] for name, values in columns.items()})
        return row | troubles(agent)


class Squadron(Pilot):
    """Flies batches of episodes side by side; picklable, and made anew in every worker."""

    def __call__(self, scenarios: Scenarios) -> Row:
        """The metric columns of a batch, one entry per episode."""
        env, _, flown = self._cockpit
        flown.reset(scenarios, env.reset(scenarios))
        return flight.fly(env, flown.act, scenarios, self.evaluation)


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
    pilot: Pilot, episodes: Sequence[Scenarios], jobs: int, journal: Journal, listen: Callable[[int], None]
) -> "pd.DataFrame":
    """Rows of ``episodes`` in their order, flown by ``jobs`` processes; those in the journal are not flown again.

    ``listen`` hears how many are done. Raises RunFailed when a worker process dies.
    """
    rows = {number: row for number, row in journal.read().items() if number < len(episodes)}
    missing = [number for number in range(len(episodes)) if number not in rows]
    listen(len(rows))
    try:
        for index, row in workers.share(pilot, [episodes[number] for number in missing], jobs):
            journal.add(missing[index], row)
            rows[missing[index]] = row
            listen(len(rows))
    except workers.WorkerLost as lost:
        kept = f"{len(rows)} of {len(episodes)} episodes are kept: the same command again goes on from there"
        raise RunFailed(f"{lost}; {kept if journal.path else 'no episode was kept'}") from lost
    return table([rows[number] for number in range(len(episodes))])


def table(rows: Sequence[Row]) -> "pd.DataFrame":
    """Rows of JSON types as columns; only numbers that are not finite are null."""
    import pandas as pd  # workers do without

    missing = float("nan")
    return pd.DataFrame([{name: missing if value is None else value for name, value in row.items()} for row in rows])
