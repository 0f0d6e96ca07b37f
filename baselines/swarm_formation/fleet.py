"""The fleet of Swarm-Formation: decentralised planners that share trajectories by messages, and nothing else."""

import numpy as np

from baselines.planner.interface import Failure, Task, Trajectory, View
from baselines.planner.messages import Bus
from baselines.swarm_formation.drone import Drone
from baselines.swarm_formation.planner import Planner, peaks
from baselines.swarm_formation.reference import Course, goals, straight
from baselines.swarm_formation.scene import survey, with_balls
from baselines.swarm_formation.similarity import laplacian
from baselines.swarm_formation.spec import SwarmFormationSpec


class SwarmFormationFleet:
    """All drones of one episode (see :class:`baselines.planner.interface.Fleet`)."""

    def __init__(self, spec: SwarmFormationSpec, task: Task, view: View, generator: np.random.Generator) -> None:
        self.failures: list[Failure] = []
        places = goals(task, view.position, spec.machine.beyond)
        self._scene = survey(task, view.position, places, spec.map.cell, spec.map.inflation)
        bus = Bus(task.drones, spec.link.delay, spec.link.loss, generator, task.links)
        wanted = laplacian(task.offsets)
        self.drones = []
        for number, (start, goal) in enumerate(zip(view.position, places, strict=True)):
            reference = straight(start, goal, spec.cost.speed)
            course = Course(reference, spec.machine.horizon, spec.cost.speed, spec.cost.acceleration)
            self.drones.append(Drone(number, start, Planner(spec, wanted, course), bus, self.failures))
        self._spec = spec

    def step(self, view: View) -> list[Trajectory]:
        """The trajectory that each of the N drones follows now."""
        scene = with_balls(self._scene, view.balls, view.time)
        return [drone.tick(view, scene) for drone in self.drones]

    @property
    def replans(self) -> int:
        """Planning attempts begun so far, all drones together."""
        return sum(drone.replans for drone in self.drones)

    def violations(self) -> list[Failure]:
        """Accepted trajectories beyond the limits at 1 ms sampling: in this method the limits are soft."""
        found = []
        for drone in self.drones:
            for plan in drone.accepted:
                speed, acceleration = peaks(plan)
                if speed > self._spec.cost.speed:
                    found.append(Failure(plan.start, drone.number, f"speed {speed:.2f} m/s"))
                if acceleration > self._spec.cost.acceleration:
                    found.append(Failure(plan.start, drone.number, f"acceleration {acceleration:.2f} m/s^2"))
        return found
