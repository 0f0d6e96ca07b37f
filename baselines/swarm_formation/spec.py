"""Settings of Swarm-Formation: one YAML in ``conf/baseline/`` for each of its parameter sets."""

from dataclasses import dataclass
from typing import NamedTuple

from baselines.planner.agent import PlannerSpec


@dataclass(frozen=True)
class MapSpec:
    """The voxel map and the search on it."""

    cell: float  # m
    inflation: int  # cells added on each side of an occupied one
    clearance: float  # m, distance from inflated cells that the search keeps
    budget: int  # cells that one search may expand


class CostSpec(NamedTuple):
    """The cost of a trajectory and its minimisation; a tuple, because compiled code reads it."""

    obstacle: float  # weight of the clearance from obstacles
    swarm: float  # weight of the clearance between drones
    formation: float  # weight of the shape; 0 while a member's trajectory is unknown and on recovery plans
    limits: float  # weight of speed and acceleration
    spacing: float  # weight of the variance of the samples' squared distances
    time: float  # weight of the duration in s
    clearance: float  # m, from inflated obstacles
    swarm_clearance: float  # m, between drones; the cost begins at 1.5 times this
    speed: float  # m/s
    acceleration: float  # m/s^2
    samples: int  # K, per piece
    unit_gradient: bool  # the repository's formation gradient of length 1 instead of the exact one
    iterations: int  # with the formation term
    recovery_iterations: int  # without it
    tolerance: float  # of the gradient against max(1, |x|)


@dataclass(frozen=True)
class MachineSpec:
    """The state machine and its clocks."""

    horizon: float  # m, how far ahead a local target lies
    piece: float  # m, pieces of a warm start
    beyond: float  # m, how far past the goal line the formation's goal lies
    period: float  # s, age at which a trajectory is replaced
    lead: float  # s, how far ahead of now a new trajectory begins
    latency: float  # s, simulated duration of a planning attempt
    watch: float  # s, between two safety checks
    emergency: float  # s, time to a hit below which a drone without a plan stops
    attempts: int  # plans tried from an emergency stop before the goal is given up


@dataclass(frozen=True)
class LinkSpec:
    """The messages between drones."""

    delay: float  # s
    loss: float  # share


@dataclass(frozen=True)
class SwarmFormationSpec(PlannerSpec):
    """Everything in ``conf/baseline/swarm_formation.yaml``."""

    map: MapSpec
    cost: CostSpec
    machine: MachineSpec
    link: LinkSpec
