"""A method through episodes of a world: the one place where world, link and agent are put together and flown.

Evaluation, recording, replay, verification, dry run, search trial and the judgement of a training all call
``EpisodeWorker.fly``. A row is the same whoever asked for it, in any company and in any process.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from algos.compilation import Compiler
from baselines.planner.agent import PlannerAgent
from baselines.planner.batched import BatchedPlanners
from baselines.protocol import Agent, Fallible
from envs import flight
from envs.flight import Watch
from envs.formation import FormationEnv, WorldSpec
from envs.metrics import EvalSpec
from envs.scenarios import cast, select
from envs.spec import Scenarios, State
from formctl.settings import build

if TYPE_CHECKING:
    from envs.deployment import DeploySpec
    from formctl.evaluation.methods import Method
    from formctl.settings import Config

GROUP = 25
"""Episodes of planners that one process flies side by side at most: what is lost when it is killed."""

Columns = dict[str, np.ndarray]
"""Metric columns by name, one entry per episode."""

Observe = Callable[[FormationEnv, Agent, State], Watch]
"""Makes the callback after every step from the world, the agent as it flies, and the state at the start."""


@dataclass(frozen=True)
class EpisodeWorker:
    """Flies batches of episodes with one method in one world. Picklable: every process makes its own world and agents.

    With ``compiled`` the world is compiled and batches are filled up to ``rules.batch``; only methods that fly any
    number of episodes side by side are. A deployment never is: rounding grows into another flight
    (``envs.deployment.Link``), and its rows are to be what the same commands give anywhere else in the program.
    """

    make: Callable[[FormationEnv], Agent]
    world: WorldSpec  # as the method flies it
    sim: str
    rules: EvalSpec
    deploy: "DeploySpec | None" = None
    compiled: bool = False

    @classmethod
    def of(cls, method: "Method", world: WorldSpec, config: "Config", *, compiled: bool = False) -> "EpisodeWorker":
        """The worker of a method in the world that ``config`` flies, without its own physics and rules."""
        deploy = config.deploy
        return cls(method.make, method.fit(world), config.sim, config.eval, deploy, compiled and deploy is None)

    @cached_property
    def env(self) -> FormationEnv:
        """The world."""
        made = build.environment(self.world, self.sim, self.deploy)
        return made.compiled(Compiler(True)) if self.compiled else made

    @cached_property
    def agent(self) -> Agent:
        """The method in this world. ValueError where it does not fit the world."""
        return self.make(self.env)

    @property
    def batched(self) -> bool:
        """Whether one agent flies any number of episodes; otherwise every episode needs one of its own."""
        return self.agent.capabilities.batched

    def check(self) -> None:
        """Raise ValueError where the method cannot fly this world, or cannot be deployed."""
        build.linked(self.agent, self.env, self.deploy)

    @property
    def portable(self) -> bool:
        """Whether another processor repeats these flights."""
        return build.linked(self.agent, self.env, self.deploy).capabilities.portable

    def fly(self, scenarios: Scenarios, observe: Observe | None = None) -> Columns:
        """Fly whole episodes; one entry per episode and column."""
        scenarios = cast(scenarios, self.env.dtype)
        agents = [self.agent] if self.batched else [self.make(self.env) for _ in scenarios.id]
        agent = build.linked(grouped(agents), self.env, self.deploy)
        start = self.env.reset(scenarios)
        agent.reset(scenarios, start)
        watch = None if observe is None else observe(self.env, agent, start)
        columns = flight.fly(self.env, agent.act, scenarios, self.rules, watch)
        return columns | planner_failures([] if self.batched else agents, len(scenarios.id))

    def __call__(self, scenarios: Scenarios) -> Columns:
        """The same for a process of a pool; what is compiled flies batches of one size only."""
        episodes = len(scenarios.id)
        if self.compiled:
            scenarios = select(scenarios, torch.arange(self.rules.batch) % episodes)
        return {name: column[:episodes] for name, column in self.fly(scenarios).items()}


def grouped(agents: Sequence[Agent]) -> Agent:
    """One agent for an episode of each of ``agents``. ValueError for several that cannot fly side by side."""
    if len(agents) == 1:
        return agents[0]
    planners = [agent for agent in agents if isinstance(agent, PlannerAgent)]
    if len(planners) < len(agents):
        raise ValueError(f"{agents[0].name} flies one episode at a time, not {len(agents)}")
    return BatchedPlanners(planners)


def group_size(agent: Agent, episodes: int, jobs: int) -> int:
    """How many episodes to fly side by side with agents like this one, so that ``jobs`` processes have work."""
    return max(1, min(GROUP, math.ceil(episodes / jobs))) if isinstance(agent, PlannerAgent) else 1


def planner_failures(agents: Sequence[Agent], episodes: int) -> Columns:
    """Columns ``planner_failures`` and ``planner_reason``: how many in each episode, and the commonest reason.

    ``agents`` are those of the episodes, or none where one agent flew all of them.
    """
    fallible = [agent for agent in agents if isinstance(agent, Fallible)]
    reasons = [[failure.reason for failure in agent.failures] for agent in fallible] or [[] for _ in range(episodes)]
    commonest = [Counter(found).most_common(1) for found in reasons]  # of equally common ones the first
    return {
        "planner_failures": np.array([len(found) for found in reasons], dtype=np.int64),
        "planner_reason": np.array([first[0][0] if first else "" for first in commonest], dtype=object),
    }


def rows_of(columns: Columns) -> list[dict[str, Any]]:
    """Columns as one dict per episode."""
    names = list(columns)
    return [dict(zip(names, values, strict=True)) for values in zip(*columns.values(), strict=True)]
