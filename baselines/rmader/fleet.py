"""All drones of an episode on one simulated clock."""

import numpy as np

from baselines.planner.interface import Failure, Task, Trajectory, View
from baselines.planner.messages import TICK, Bus
from baselines.rmader.bspline import Plan
from baselines.rmader.deconfliction import Pilot
from baselines.rmader.goals import Goals
from baselines.rmader.planner import Planner
from baselines.rmader.spec import RmaderSpec


class RmaderFleet:
    """A :class:`baselines.planner.interface.Fleet` of R-MADER planners."""

    def __init__(self, task: Task, view: View, spec: RmaderSpec, generator: np.random.Generator) -> None:
        links, *own = generator.spawn(task.drones + 1)
        bus = Bus(task.drones, spec.clock.link_delay, spec.clock.link_loss, links, task.links)
        goals = Goals(task, (view.position - task.offsets).mean(0), spec.goal, spec.limits)
        self.pilots = [
            Pilot(Planner(drone, task, goals, spec, own[drone]), Plan.resting(place, view.time), bus, spec.clock)
            for drone, place in enumerate(view.position)
        ]
        self._tick, self._ticks = spec.clock.tick, round(view.time / spec.clock.tick)

    @property
    def failures(self) -> list[Failure]:
        """Of all drones, in the order of time."""
        return sorted((failure for pilot in self.pilots for failure in pilot.failures), key=lambda one: one.time)

    @property
    def replans(self) -> int:
        """How many plans the drones have begun to search for."""
        return sum(pilot.replans for pilot in self.pilots)

    def step(self, view: View) -> list[Trajectory]:
        """Run the clock up to ``view.time``; the committed plan of every drone."""
        for pilot in self.pilots:
            pilot.see(view.balls, view.time)
        while self._ticks * self._tick <= view.time + TICK:
            for pilot in self.pilots:
                pilot.tick(self._ticks * self._tick)
            self._ticks += 1
        return [pilot.plan for pilot in self.pilots]
