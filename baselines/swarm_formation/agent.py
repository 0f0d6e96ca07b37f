"""Swarm-Formation as an agent."""

from dataclasses import replace

import numpy as np

from baselines.planner.agent import PlannerAgent
from baselines.planner.interface import Fleet, Task, View
from baselines.swarm_formation.fleet import SwarmFormationFleet
from baselines.swarm_formation.spec import SwarmFormationSpec
from envs.formation import FormationEnv


class SwarmFormation(PlannerAgent):
    """Distributed trajectory optimisation in formation (Quan et al., ICRA 2022), adapted to balls as in the paper.

    Its optimiser stops at tolerances: where the last bits differ, so does now and then the side that a drone takes.
    """

    capabilities = replace(PlannerAgent.capabilities, portable=False)

    def __init__(self, name: str, env: FormationEnv, spec: SwarmFormationSpec) -> None:
        if not 0 <= spec.machine.latency <= spec.machine.lead:
            raise ValueError(
                f"baseline '{name}': baseline.machine.latency={spec.machine.latency:g} s is more than the lead of "
                f"{spec.machine.lead:g} s that a plan has before it begins"
            )
        super().__init__(name, env, spec)
        self.spec: SwarmFormationSpec = spec

    def fleet(self, task: Task, view: View, generator: np.random.Generator) -> Fleet:
        """The planners of all drones for one episode, which starts as ``view`` shows."""
        return SwarmFormationFleet(self.spec, task, view, generator)
