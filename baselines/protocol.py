"""What a method has to offer to be flown, evaluated and compared."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol, runtime_checkable

from torch import Tensor

from baselines.planner.interface import Failure, Trajectory
from envs.formation import FormationEnv, WorldSpec
from envs.spec import RotorDroneSpec, Scenarios, State


@dataclass(frozen=True)
class Capabilities:
    """What a method can do and what it needs to know; the evaluation asks these, never a method's name."""

    command: Literal["ctbr", "rotor"]  # body rates and collective thrust (env.step's action), or four rotor thrusts
    batched: bool  # flies any number of episodes side by side; otherwise one at a time
    needs_ball_parameters: bool  # is told a ball's launch, not only where it is now
    max_drones: int | None  # None: any number
    min_drones: int = 1
    period: float | None = None  # s, between rotor commands; CTBR is given whenever the world asks
    portable: bool = True  # rounding is no matter; otherwise it tips decisions, and only one processor repeats a flight

    def fit(self, world: WorldSpec) -> WorldSpec:
        """The world with its craft told rotor thrusts where that is what the method commands; else the same."""
        drone = world.drone
        if self.command != "rotor" or self.period is None or drone.command == "rotor":
            return world
        return replace(world, drone=RotorDroneSpec.of(drone, self.period))

    def misfit(self, env: FormationEnv) -> str | None:
        """Why a method of these capabilities cannot fly in ``env``, in words that follow its name; None if it can."""
        scenario = env.world.scenario
        if self.max_drones is not None and env.drones > self.max_drones:
            return f"flies at most {self.max_drones} drones, the formation has {env.drones}"
        if env.drones < self.min_drones:
            return f"flies at least {self.min_drones} drones, the formation has {env.drones}"
        if self.command not in env.commands:
            return f"commands {self.command}, this world takes {' or '.join(env.commands)}"
        if self.needs_ball_parameters and scenario.balls and scenario.sensing_range <= 0:
            return "has to see balls fly: give scenario.sensing_range a positive value, or scenario.balls=0"
        return None


@runtime_checkable
class Agent(Protocol):
    """A method that flies formations.

    Built by :func:`baselines.registry.make`. ``act`` may depend on the state, on the columns in ``scenarios`` and on
    what the agent remembers since ``reset``; balls it may know only as its capabilities declare, and never before the
    throw. The same calls give the same commands: randomness is seeded at ``reset``.
    """

    name: str
    capabilities: Capabilities

    def reset(self, scenarios: Scenarios, state: State) -> None:
        """Prepare for the episodes in ``scenarios``, which start from ``state``."""
        ...

    def act(self, state: State, scenarios: Scenarios) -> Tensor:
        """Command (E, N, 4) in [-1, 1] for the next control period."""
        ...


@runtime_checkable
class Fallible(Protocol):
    """An agent for one episode at a time that says what failed in it: the columns ``planner_*`` of its rows."""

    @property
    def failures(self) -> Sequence[Failure]:
        """What failed since ``reset``, in the order of time."""
        ...


@runtime_checkable
class Planning(Protocol):
    """What an agent offers beside :class:`Agent` when it has plans that a recording can show."""

    def plans(self) -> Sequence[Trajectory]:
        """The trajectories that the N drones of its only episode are following now."""
        ...
