"""R-MADER as an agent."""

import numpy as np

from baselines.planner.agent import PlannerAgent
from baselines.planner.interface import Task, View
from baselines.rmader.fleet import RmaderFleet
from baselines.rmader.spec import RmaderSpec
from envs.formation import FormationEnv


class Rmader(PlannerAgent):
    """Kondo et al., RA-L 2023, with the paper's adaptations: goals in formation, balls as fitted parabolas."""

    def __init__(self, name: str, env: FormationEnv, spec: RmaderSpec) -> None:
        super().__init__(name, env, spec)
        self._rmader = spec

    def fleet(self, task: Task, view: View, generator: np.random.Generator) -> RmaderFleet:
        """The planners of one episode."""
        return RmaderFleet(task, view, self._rmader, generator)
