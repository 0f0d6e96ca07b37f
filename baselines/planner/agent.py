"""A fleet of planners as an agent: views in, trajectories out, commands to the drones through the shared tracker.

Two ways of commanding, so that failures of planning and of tracking can be told apart: ``waypoints`` sends positions
only, at 10 Hz, as the paper flew its planners; ``feed_forward`` sends all that the trajectory knows at every control
period, as the planners' own code does.
"""

import logging
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from baselines.planner.interface import Array, Failure, Fleet, State, Task, Trajectory, View
from baselines.planner.sight import Glance, Sight, glances, task
from baselines.protocol import Capabilities
from baselines.tracker import Reference, TrackerSpec, track
from envs.formation import FormationEnv
from envs.spec import Scenarios
from envs.spec import State as WorldState

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class AdapterSpec:
    """How a fleet sees and commands (``conf/baseline/adapter/``)."""

    mode: Literal["waypoints", "feed_forward"]
    waypoint_period: float  # s, between two position commands
    frame_spacing: float  # s, between the two frames of a ball
    seed: int


@dataclass(frozen=True)
class PlannerSpec:
    """What every planner's YAML holds besides the planner's own settings."""

    deviations: tuple[str, ...]  # sentences: where this differs from the published method
    adapter: AdapterSpec
    tracker: TrackerSpec


@dataclass(frozen=True)
class Standing:
    """A trajectory that stays at one place (3,) in m."""

    place: Array
    start: float = 0.0
    end: float = 0.0

    def at(self, time: Array) -> State:
        """Shapes (T, 3), everything but the position zero."""
        still = np.zeros((len(time), 3))
        return State(still + self.place, still, still, still)


class PlannerAgent(ABC):
    """Flies one episode at a time with the fleet that ``fleet`` makes at its start.

    ``failures`` are those of the current episode: the fleet's own, and whatever it raised or returned that cannot be
    flown. After such a failure a drone keeps its last trajectory, and stands where it is when there is none.
    """

    capabilities = Capabilities(command="ctbr", batched=False, needs_ball_parameters=True, max_drones=None)

    def __init__(self, name: str, env: FormationEnv, spec: PlannerSpec) -> None:
        self.name, self.env, self.spec = name, env, spec
        self._hold = _periods(name, env, "waypoint_period", spec.adapter.waypoint_period)
        _periods(name, env, "frame_spacing", spec.adapter.frame_spacing)
        self._fleet: Fleet | None = None
        self._own: list[Failure] = []

    @property
    def failures(self) -> list[Failure]:
        """What failed in the episode so far, in the order of time."""
        theirs = [] if self._fleet is None else self._fleet.failures
        return sorted([*theirs, *self._own], key=lambda failure: failure.time)

    def plans(self) -> list[Trajectory]:
        """What the N drones are following now, for recordings."""
        return list(self._flown)

    @abstractmethod
    def fleet(self, task: Task, view: View, generator: np.random.Generator) -> Fleet:
        """The planners of all drones for one episode, which starts as ``view`` shows."""

    @property
    def lead(self) -> float:
        """Seconds that waypoints are sampled ahead: what a held position command lags behind at steady speed.

        K_v / K_p from the tracker's damping, and half a waypoint period from holding.
        """
        gains = self.spec.tracker
        return gains.velocity_gain / gains.position_gain + self._hold * self.env.dt / 2

    def reset(self, scenarios: Scenarios, state: WorldState) -> None:
        """Get ready for an episode; its fleet is made at the first command. ValueError for more than one episode."""
        if len(scenarios.id) != 1:
            raise ValueError(f"baseline '{self.name}' flies one episode at a time, not {len(scenarios.id)}")
        self._task = task(self.env, scenarios)
        self._sight = Sight(self.env.world.scenario, self.spec.adapter.frame_spacing)
        self._seed = [self.spec.adapter.seed, int(scenarios.id[0])]
        self._fleet, self._own = None, []
        self._flown: list[Trajectory] = [Standing(place) for place in state.position[0].double().numpy()]
        self._samples: list[State] = []

    def act(self, state: WorldState, scenarios: Scenarios) -> Tensor:
        """Command (1, N, 4) for the next control period."""
        (glance,) = glances(state, self.env.dt)
        return self.steer(state, [self.motions(glance)])

    def motions(self, glance: Glance) -> list[State]:
        """Plan, and how each of the N drones should move now, parts (3,)."""
        view = self._sight.look(glance)
        asked = self._ask(view)
        held = self.spec.adapter.mode == "waypoints"
        if not held or round(view.time / self.env.dt) % self._hold == 0:
            time = view.time + self.lead if held else view.time
            self._samples = [self._sample(drone, asked[drone], time, view) for drone in range(self._task.drones)]
        return self._samples

    def steer(self, state: WorldState, motions: list[list[State]]) -> Tensor:
        """Command (E, N, 4) that brings the drones of E episodes to their ``motions`` (E lists of N)."""
        parts = (
            torch.from_numpy(np.array([[sample[part] for sample in episode] for episode in motions]))
            for part in range(len(State._fields))
        )
        position, velocity, acceleration, jerk = (part.to(state.position) for part in parts)
        if self.spec.adapter.mode == "waypoints":
            reference = Reference.moving(position, torch.zeros_like(position))
        else:
            reference = Reference(position, velocity, acceleration, jerk, yaw=torch.zeros_like(position[..., 0]))
        return track(state, reference, self.env.world.drone, self.spec.tracker)

    def _ask(self, view: View) -> list[Trajectory]:
        """The fleet's trajectories; the last ones where it fails."""
        try:
            if self._fleet is None:
                self._fleet = self.fleet(self._task, view, np.random.default_rng(self._seed))
            asked = list(self._fleet.step(view))
            if len(asked) != self._task.drones:
                raise ValueError("the fleet did not return one trajectory per drone")
        except Exception as error:  # a bug of a planner or its solver is a result, not the end of an evaluation
            self._fail(view, -1, error)
            return self._flown
        return asked

    def _sample(self, drone: int, asked: Trajectory, time: float, view: View) -> State:
        """The drone's motion at ``time``: of the trajectory asked for, else of its last one, else standing here."""
        last = self._flown[drone]
        for trajectory in (asked,) if asked is last else (asked, last):
            try:
                sample = _checked(trajectory, time)
            except Exception as error:  # the same
                self._fail(view, drone, error)
            else:
                self._flown[drone] = trajectory
                return sample
        self._flown[drone] = Standing(view.position[drone])
        return _checked(self._flown[drone], time)

    def _fail(self, view: View, drone: int, error: Exception) -> None:
        logger.debug("%s, drone %d at %.2f s", self.name, drone, view.time, exc_info=error)
        lines = str(error).splitlines()
        reason = f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
        self._own.append(Failure(view.time, drone, reason[:120]))


def _checked(trajectory: Trajectory, time: float) -> State:
    """One sample, parts (3,), of a trajectory that stands still before its start and after its end."""
    sample = State(*(np.asarray(part, dtype=float)[0] for part in trajectory.at(np.array([time]))))
    if any(part.shape != (3,) or not np.isfinite(part).all() for part in sample):
        raise ValueError("a trajectory is not finite")
    return sample


def _periods(name: str, env: FormationEnv, key: str, seconds: float) -> int:
    """``seconds`` as a number of control periods. ValueError where it is none."""
    periods = round(seconds / env.dt)
    if periods < 1 or abs(periods * env.dt - seconds) > 1e-6:
        raise ValueError(
            f"baseline '{name}': baseline.adapter.{key}={seconds:g} s is no multiple of drone.control_period="
            f"{env.dt:g} s"
        )
    return periods
