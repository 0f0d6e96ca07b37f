"""Milliseconds per replan of one drone, on one thread, in the first episodes of a scenario.

python -m tests.benchmarks.planners --baseline rmader_fair scenario=mixed
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
import typer

from baselines.planner.agent import PlannerAgent
from baselines.planner.interface import Failure, Fleet, Task, Trajectory, View
from envs.formation import FormationEnv
from envs.scenarios import sample, select
from envs.spec import Scenarios
from formctl.console import table
from formctl.errors import ConfigError
from formctl.evaluation import methods
from formctl.evaluation.methods import Method
from formctl.settings import Config, build, choices, compose


@dataclass(frozen=True)
class ReplanTime:
    """One line of the benchmark: milliseconds of processor time per replan of one drone."""

    planner: str
    columns: int
    balls: int
    replans: int
    median: float
    tail: float  # 95th percentile
    episode_share: float  # seconds of planning per second of flight, all drones


def main(
    overrides: Annotated[list[str] | None, typer.Argument()] = None,
    baseline: Annotated[list[str] | None, typer.Option(help="A planner; may be repeated. Default all.")] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="Length of each measured flight.")] = 6.0,
) -> None:
    """Print one line per planner."""
    words = list(overrides or [])
    config = compose(words if any(word.startswith("scenario=") for word in words) else ["scenario=mixed", *words])
    lines = [measure(config, method, seconds) for method in selected(config, baseline or [])]
    cells = [
        (line.planner, f"{line.replans}", f"{line.median:.1f}", f"{line.tail:.1f}", f"{line.episode_share:.2f}")
        for line in lines
    ]
    scenario = config.scenario
    head = ("planner", "replans", "median ms", "95 % ms", "planning s per s of flight")
    table(head, cells, title=f"scenario {scenario.name}: {scenario.columns} columns, {scenario.balls} balls")


def selected(config: Config, names: Sequence[str]) -> list[Method]:
    """The baselines called ``names``, or all that are planners. Raises ConfigError for one that is none."""
    world = build.world(config)
    known = [methods.baseline(name) for name in names or choices("baseline")]
    made = [method.make(build.environment(method.fit(world), config.sim)) for method in known]
    kinds = [isinstance(agent, PlannerAgent) for agent in made]
    for method, planner in zip(known, kinds, strict=True):
        if names and not planner:
            raise ConfigError(f"baseline {method.name!r} plans nothing: leave it out")
    return [method for method, planner in zip(known, kinds, strict=True) if planner]


class TimedFleet:
    """A fleet whose steps are timed: ``steps`` holds (replans begun, seconds) of each."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self.steps: list[tuple[int, float]] = []

    @property
    def failures(self) -> list[Failure]:
        return self._fleet.failures

    @property
    def replans(self) -> int:
        return self._fleet.replans

    def step(self, view: View) -> list[Trajectory]:

        before, begun = self._fleet.replans, time.process_time()
        trajectories = self._fleet.step(view)
        self.steps.append((self._fleet.replans - before, time.process_time() - begun))
        return trajectories


def measure(config: Config, method: Method, seconds: float) -> ReplanTime:
    """Fly the first two episodes with ``method``: the first one compiles and is not counted."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        env = build.environment(build.world(config), config.sim)
        scenarios = sample(config.scenario, 2, config.eval.seed)
        for index in range(2):
            agent = method.make(env)
            assert isinstance(agent, PlannerAgent)
            watch = flight(env, agent, select(scenarios, slice(index, index + 1)), seconds)
    finally:
        torch.set_num_threads(before)
    each = np.array([1e3 * spent / count for count, spent in watch.steps if count] or [np.nan])
    share = sum(spent for _, spent in watch.steps) / (len(watch.steps) * env.dt)
    median, tail = np.percentile(each, (50, 95))
    scenario = config.scenario
    return ReplanTime(
        method.name, scenario.columns, scenario.balls, watch.replans, float(median), float(tail), float(share)
    )


def flight(env: FormationEnv, agent: PlannerAgent, scenarios: Scenarios, seconds: float) -> TimedFleet:
    """Fly ``seconds`` of one episode; the agent's fleet with its steps timed."""
    watches: list[TimedFleet] = []
    build = agent.fleet

    def timed(task: Task, view: View, generator: np.random.Generator) -> TimedFleet:
        watches.append(TimedFleet(build(task, view, generator)))
        return watches[-1]

    agent.fleet = timed  # type: ignore[method-assign,assignment]
    with torch.no_grad():
        state = env.reset(scenarios)
        agent.reset(scenarios, state)
        for _ in range(round(seconds / env.dt)):
            state, _, _ = env.step(state, agent.act(state, scenarios), scenarios)
    return watches[0]


if __name__ == "__main__":
    typer.run(main)
