"""Several episodes of a planner in one world: what the drones do is computed for all of them at once.

A step of the world costs nearly the same for one episode and for ten, and so does the tracker. Each episode keeps its
own planner; neither the world nor the tracker mixes episodes, so a row is the same in any company.
"""

from collections.abc import Sequence

from torch import Tensor

from baselines.planner.agent import PlannerAgent
from baselines.planner.sight import glances
from envs.scenarios import select
from envs.spec import Scenarios, State


class BatchedPlanners:
    """As many episodes as there are planners, which are alike; itself an agent."""

    def __init__(self, planners: Sequence[PlannerAgent]) -> None:
        self.planners = tuple(planners)
        self.name, self.capabilities = planners[0].name, planners[0].capabilities

    def reset(self, scenarios: Scenarios, state: State) -> None:
        """Get every planner ready for its episode. ValueError where their numbers differ."""
        if len(scenarios.id) != len(self.planners):
            raise ValueError(f"{len(self.planners)} planners cannot fly {len(scenarios.id)} episodes")
        for number, planner in enumerate(self.planners):
            own = slice(number, number + 1)
            planner.reset(select(scenarios, own), State(*(field[own] for field in state)))

    def act(self, state: State, scenarios: Scenarios) -> Tensor:
        """Command (E, N, 4) for the next control period."""
        lead = self.planners[0]
        seen = zip(self.planners, glances(state, lead.env.dt), strict=True)
        return lead.steer(state, [planner.motions(glance) for planner, glance in seen])
