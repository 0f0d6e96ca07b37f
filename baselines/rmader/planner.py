"""One replan: from the state that a committed plan will have to a new plan, through search and back end."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from baselines.planner.interface import Array, Parabola, Task
from baselines.rmader import backend, hulls
from baselines.rmader.bspline import INTERVALS, Plan, first_controls
from baselines.rmader.goals import Goals
from baselines.rmader.search import Rules, octopus, touching
from baselines.rmader.spec import RmaderSpec
from baselines.rmader.timing import longest_interval

SHORTEST = 0.01
"""s; a plan of shorter intervals could go nowhere."""


@dataclass(frozen=True)
class Proposal:
    """A new plan before it is committed."""

    controls: Array  # (7, 3) m
    interval: float  # s
    start: float  # s

    @property
    def plan(self) -> Plan:
        """The new piece alone."""
        return Plan.spline(self.controls, self.interval, self.start)


class NoPlan(Exception):
    """Nothing that keeps all constraints was found; the message says at which stage."""


class Planner:
    """Search and back end for one drone."""

    def __init__(self, drone: int, task: Task, goals: Goals, spec: RmaderSpec, generator: np.random.Generator) -> None:
        self.drone, self.goals, self.spec = drone, goals, spec
        self._task, self._generator = task, generator
        self._columns = hulls.columns(task, spec.size)
        self._grid = np.array(list(product(np.linspace(0, 1, spec.search.samples), repeat=3)))
        limits, side = spec.limits, task.corridor - spec.limits.margin
        low, high = task.altitude
        self._bounds = backend.Bounds(
            limits.speed,
            limits.acceleration,
            limits.jerk,
            np.array([-side, -np.inf, low + limits.margin]),
            np.array([side, np.inf, high - limits.margin]),
            spec.goal.reach,
        )

    def propose(self, plan: Plan, start: float, others: list[Plan], balls: list[Parabola]) -> Proposal:
        """A plan that leaves the committed ``plan`` at ``start`` (s) and avoids what is known. Raises NoPlan."""
        state = plan.at(np.array([start]))
        position, velocity, acceleration = state.position[0], state.velocity[0], state.acceleration[0]
        goal, duration = self.goals.aim(self.drone, start, position, velocity)
        longest = longest_interval(velocity, acceleration, self.spec.limits.speed)
        interval = min(duration / INTERVALS, longest)
        if interval < SHORTEST:
            raise NoPlan("no interval: the start is at the speed limit")
        scene = self._scene(start, interval, position, others, balls)
        controls = self._search(first_controls(position, velocity, acceleration, interval), interval, goal, scene)
        planes = backend.planes(scene, controls)
        if planes is None:
            raise NoPlan("a plane was lost after the search")
        search = self.spec.search
        smooth = backend.smooth(
            controls, interval, goal, planes, self._bounds, search.terminal_weight, search.exchanges
        )
        if smooth is None:
            raise NoPlan("back end infeasible")
        return Proposal(smooth, interval, start)

    def conflicts(self, proposal: Proposal, others: list[Plan], balls: list[Parabola]) -> bool:
        """Whether ``proposal`` meets another drone's plan, or a ball at its true size."""
        if not others and not balls:
            return False
        size = self.spec.size
        solids = [hulls.other(plan, size, check=True) for plan in others]
        solids += [hulls.ball(ball, self._task, size, check=True) for ball in balls]
        first = proposal.controls[0]
        scene = hulls.scene(solids, proposal.start, proposal.interval, first, self.spec.goal.reach)
        return touching(proposal.controls, scene.vertices, scene.starts)

    def _scene(
        self, start: float, interval: float, centre: Array, others: list[Plan], balls: list[Parabola]
    ) -> hulls.Scene:
        size = self.spec.size
        solids = [*self._columns, *(hulls.ball(ball, self._task, size) for ball in balls)]
        solids += [hulls.other(plan, size) for plan in others]
        return hulls.scene(solids, start, interval, centre, self.spec.goal.reach)

    def _search(self, first: Array, interval: float, goal: Array, scene: hulls.Scene) -> Array:
        """Control points (7, 3) of a clear polygon; the samples are tried in a random order. Raises NoPlan."""
        search, bounds, limits = self.spec.search, self._bounds, self.spec.limits
        self._generator.shuffle(self._grid)
        rules = Rules(
            step=interval,
            goal=goal,
            reach=bounds.reach,
            bounds=np.stack((bounds.low, bounds.high)),
            limits=np.array((limits.speed, limits.acceleration)),
            grid=self._grid,
            shrink=search.shrink,
            voxel=search.voxel,
            bias=search.bias,
            arrival=search.arrival,
            budget=search.nodes,
        )
        controls, _ = octopus(first, rules, scene.vertices, scene.starts)
        if controls is None:
            raise NoPlan("search infeasible")
        return controls
