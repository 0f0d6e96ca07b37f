"""A planner of one's own: artificial potential fields (Khatib, 1986) that push drones away from columns and balls.

formctl eval --baseline examples/own_planner.py:PotentialField scenario=static
formctl eval --baseline examples/own_planner.py:PotentialField scenario=mixed baseline.reach=2
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from baselines.protocol import Capabilities
from baselines.tracker import Reference, TrackerSpec, track
from envs import obstacles
from envs.formation import FormationEnv
from envs.spec import Scenarios, State


@dataclass(frozen=True)
class Settings:
    """What ``baseline.KEY=VALUE`` changes."""

    push: float = 3.0  # m/s, at the obstacle
    reach: float = 1.2  # m, where it begins


class PotentialField:
    """Every drone flies v*, is drawn to its slot beside the team's mean, and is pushed away from what is near."""

    capabilities = Capabilities(command="ctbr", batched=True, needs_ball_parameters=False, max_drones=None)
    tracker = TrackerSpec(6.0, 4.0, (10.0, 10.0, 5.0), max_tilt=0.785, thrust_reserve=0.1)

    def __init__(self, name: str, env: FormationEnv, spec: Settings) -> None:
        self.name, self.env, self.spec = name, env, spec

    def reset(self, scenarios: Scenarios, state: State) -> None:
        """Nothing to remember."""

    def act(self, state: State, scenarios: Scenarios) -> Tensor:
        """Commands (E, N, 4) in [-1, 1]."""
        task, position = self.env.world.scenario, state.position
        ball, _, flying = obstacles.balls_at(state, self.env.time(state))
        away = position[:, :, None, :2] - torch.cat((scenarios.columns, ball[..., :2]), 1)[:, None]  # (E, N, C + M, 2)
        distance = away.norm(dim=-1, keepdim=True).clamp_min(1e-3)
        there = torch.cat((torch.ones_like(scenarios.columns[..., 0], dtype=torch.bool), flying), 1)[:, None, :, None]
        push = torch.where(there, self.spec.push * (1 - distance / self.spec.reach).clamp_min(0), 0.0)
        velocity = position.new_tensor(task.velocity).expand_as(position).clone()
        velocity[..., :2] += (push * away / distance).sum(2)
        slots = self.env.slots
        place = slots.expand_as(position).clone()
        place[..., 1:2] += (position - slots)[..., 1:2].mean(1, keepdim=True)
        place[..., 2] += task.height
        return track(state, Reference.moving(place, velocity), self.env.world.drone, self.tracker)
