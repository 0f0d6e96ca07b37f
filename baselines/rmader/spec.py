"""Every setting of R-MADER (``conf/baseline/rmader.yaml``)."""

from dataclasses import dataclass
from typing import Literal

from baselines.planner.agent import PlannerSpec


@dataclass(frozen=True)
class LimitSpec:
    """What a plan may ask of a drone, along each world axis."""

    speed: float  # m/s
    acceleration: float  # m/s^2
    jerk: float  # m/s^3
    margin: float  # m, kept from the ground and ceiling crash limits and from the corridor's sides


@dataclass(frozen=True)
class SizeSpec:
    """How large things are made before hulls are built of them."""

    drone: float  # m, edge of the drone's box, added half to obstacles and whole to other drones
    tracking: float  # m, alpha: the drone may be this far off its plan
    prediction: float  # m, beta: an obstacle may be this far off its prediction
    sampling: float  # s, gamma: between two boxes along an obstacle's path
    check: float  # m, added to the own plan when it is checked against the others'
    all_vertices: bool  # other drones: inflate every vertex (MADER), or only the last of each piece (R-MADER's code)


@dataclass(frozen=True)
class GoalSpec:
    """Where a drone wants to go and how long it may take."""

    mode: Literal["destination", "moving"]  # the slot beyond the goal line (paper), or the slot in the formation at v*
    beyond: float  # m, from the goal line to the rearmost slot of the destination
    reach: float  # m, R_a: the sphere about the start of a plan that it has to stay within
    radius: float  # m, from the end of the plan to the destination within which nothing is planned any more
    near: float  # m, from the destination within which plans take longer
    near_factor: float  # times the least time, near the destination
    factor: float  # times the least time, elsewhere
    horizon: float  # s, least duration of a plan towards a moving goal


@dataclass(frozen=True)
class SearchSpec:
    """The octopus search and the convex back end."""

    samples: int  # velocities per axis and level
    shrink: float  # share of the allowed velocities that is sampled
    voxel: float  # share of the spread of first steps that one expanded voxel covers, beyond the shortest
    bias: float  # weight of the distance to the goal in the priority
    nodes: int  # nodes taken from the queue at most
    arrival: float  # m, from the goal at which the search stops
    terminal_weight: float  # of the squared distance to the goal against the squared jerk, in the back end
    exchanges: int  # iterations of the back end's solver at most


@dataclass(frozen=True)
class ClockSpec:
    """The simulated clock, the links, and the rules of deconfliction."""

    tick: float  # s, a divisor of the control period
    latency: float  # s, search and back end together
    link_delay: float  # s, from a drone to another
    link_loss: float  # share of messages that never arrive
    delay_check: float  # s, delta_DC
    checks: int  # tests during a delay check
    lead_factor: float  # times the duration of the last replan: how far ahead the next one starts
    lead_range: tuple[float, float]  # s, the lead is clipped to
    first_lead: float  # s, before anything has been planned
    stagger: float  # s, between the first replans of one drone and the next
    republish: float  # s, between two messages of a drone that has stopped


@dataclass(frozen=True)
class RmaderSpec(PlannerSpec):
    """Settings of :class:`baselines.rmader.agent.Rmader`."""

    limits: LimitSpec
    size: SizeSpec
    goal: GoalSpec
    search: SearchSpec
    clock: ClockSpec
