"""Agents that avoid nothing: what any method has to beat, and a check of the world and of the tracker."""

from dataclasses import dataclass

import torch
from torch import Tensor

from baselines.protocol import Capabilities
from baselines.tracker import Reference, TrackerSpec, track
from envs.formation import FormationEnv
from envs.spec import Scenarios, State


@dataclass(frozen=True)
class HoverSpec:
    """Settings of :class:`Hover` (``conf/baseline/hover.yaml``)."""

    tracker: TrackerSpec


class Hover:
    """Stays in formation at the start, at the commanded altitude."""

    capabilities = Capabilities(command="ctbr", batched=True, needs_ball_parameters=False, max_drones=None)

    def __init__(self, name: str, env: FormationEnv, spec: HoverSpec) -> None:
        self.name, self.env, self.spec = name, env, spec

    def reset(self, scenarios: Scenarios, state: State) -> None:
        """Nothing to prepare."""

    def act(self, state: State, scenarios: Scenarios) -> Tensor:
        """Command (E, N, 4) towards the slots at the start."""
        place = places(self.env, state)
        return track(state, Reference.moving(place, torch.zeros_like(place)), self.env.world.drone, self.spec.tracker)


@dataclass(frozen=True)
class StraightLineSpec:
    """Settings of :class:`StraightLine` (``conf/baseline/straight_line.yaml``)."""

    acceleration: float  # m/s^2
    tracker: TrackerSpec


class StraightLine:
    """Flies the target velocity in formation and avoids nothing: the floor under every avoidance figure.

    The formation accelerates steadily from rest to v* and then keeps it; every drone tracks its moving slot.
    """

    capabilities = Capabilities(command="ctbr", batched=True, needs_ball_parameters=False, max_drones=None)

    def __init__(self, name: str, env: FormationEnv, spec: StraightLineSpec) -> None:
        if spec.acceleration <= 0:
            raise ValueError(f"baseline.acceleration={spec.acceleration} m/s^2 never reaches v*: use a positive value")
        self.name, self.env, self.spec = name, env, spec

    def reset(self, scenarios: Scenarios, state: State) -> None:
        """Nothing to prepare."""

    def act(self, state: State, scenarios: Scenarios) -> Tensor:
        """Command (E, N, 4) towards the moving slots."""
        start = places(self.env, state)
        velocity = start.new_tensor(self.env.world.scenario.velocity)
        speed = torch.linalg.vector_norm(velocity)
        ramp = speed / self.spec.acceleration  # s, from rest to v*
        time = self.env.time(state)[:, None, None]
        share = (time / ramp).clamp_max(1)
        travelled = 0.5 * share.square() * ramp + (time - ramp).clamp_min(0)  # s at v*
        still = torch.zeros_like(start)
        reference = Reference(
            position=start + velocity * travelled,
            velocity=velocity * share + still,
            acceleration=torch.where(time < ramp, velocity / ramp, 0.0) + still,
            jerk=still,
            yaw=still[..., 0],
        )
        return track(state, reference, self.env.world.drone, self.spec.tracker)


def places(env: FormationEnv, state: State) -> Tensor:
    """The formation's slots (E, N, 3) in m around the start, without the jitter, at the commanded altitude."""
    scenario = env.world.scenario
    reference = state.position.new_tensor((*scenario.start[:2], scenario.height))
    return (reference + env.slots).expand_as(state.position)
