"""Running statistics of finished training episodes: flown with exploration noise, so a lower bound of the policy."""

from collections import deque
from typing import Any

import torch
from torch import Tensor

from envs.formation import FormationEnv
from envs.spec import Events, State
from envs.vocabulary import OBJECTIVES

AVERAGED = (*(f"reward_{name}" for name in OBJECTIVES), "fm", "speed", "speed_error")
"""Means over the steps of an episode; `fm` in m is the mean unnormalised Laplacian distance, speeds are in m/s."""

FAILURES = ("column", "ball", "drone", "ground", "ceiling")
"""What any drone of the team met during the episode."""

WIDTH = 1 + len(AVERAGED) + len(FAILURES)
"""Columns of a tally (E, WIDTH): steps, sums of the averaged, latched failures."""

KEYS = ("seconds", *AVERAGED, *(f"fail_{name}" for name in FAILURES), "collision_free", "reached", "cfr")

FEWER = {"fm", "speed_error", *(f"fail_{name}" for name in FAILURES)}
"""Keys of which less is better."""


def met(metrics: dict[str, float], goal: dict[str, float]) -> bool:
    """Whether the `train/` statistics among `metrics` are at least as good as every number of `goal`."""

    def reached(key: str, wanted: float) -> bool:
        now = metrics.get(f"train/{key}")
        return now is not None and (now <= wanted if key in FEWER else now >= wanted)

    return all(reached(key, wanted) for key, wanted in goal.items())


def tally_step(env: FormationEnv, tally: Tensor, state: State, reward: Tensor, events: Events) -> Tensor:
    """The tally after one more step; pure, compiles together with the step."""
    scenario = env.world.scenario
    wanted = state.velocity.new_tensor(scenario.velocity)
    ahead = (state.velocity * wanted).sum(-1) / wanted.square().sum().sqrt().clamp_min(1e-6)
    off = (state.velocity - wanted).square().sum(-1).sqrt()
    sums = torch.cat(
        (
            torch.ones_like(tally[:, :1]),
            reward.detach().mean(1),
            torch.stack((events.formation_error, ahead.mean(-1), off.mean(-1)), -1),
        ),
        -1,
    ).detach()
    low, high = scenario.altitude
    radius = scenario.hit_radius
    height = state.position[..., 2]
    met = (events.column < radius, events.ball < radius, events.drone < radius, height < low, height > high)
    latched = torch.stack([drones.any(-1) for drones in met], -1).to(tally)
    split = sums.shape[1]
    return torch.cat((tally[:, :split] + sums, torch.maximum(tally[:, split:], latched)), -1)


def finished_sums(env: FormationEnv, tally: Tensor, state: State, counted: Tensor) -> Tensor:
    """(1 + len(KEYS),) count of the `counted` (E,) episodes and sums of their metrics in the order of KEYS."""
    steps = tally[:, :1].clamp_min(1)
    failures = tally[:, 1 + len(AVERAGED) :]
    free = (failures.sum(-1) == 0).to(tally)
    reached = (state.position[..., 1] > env.world.scenario.goal).all(-1).to(tally)
    means = tally[:, 1 : 1 + len(AVERAGED)] / steps
    rows = torch.cat(
        (torch.ones_like(steps), steps * env.dt, means, failures, torch.stack((free, reached, free * reached), -1)), -1
    )
    return torch.where(counted[:, None], rows, 0.0).double().sum(0)


class EpisodeStatistics:
    """Means over the last `window` finished episodes, or fewer when those ended more than `horizon` steps ago.

    Whole updates are kept or forgotten. Without the horizon, a policy that has just learnt to survive would be shown
    its old crashes until `window` of its long episodes are over.
    """

    def __init__(self, window: int, horizon: int) -> None:
        self.window, self.horizon = window, horizon
        self.updates: deque[tuple[int, Tensor]] = deque()

    def add(self, steps: int, sums: Tensor) -> None:
        """Take in the `finished_sums` of an update that lasted `steps` steps."""
        self.updates.append((steps, sums.cpu()))
        while self._enough(list(self.updates)[1:]):
            self.updates.popleft()

    def _enough(self, updates: list[tuple[int, Tensor]]) -> bool:
        episodes = sum(float(sums[0]) for _, sums in updates)
        return episodes >= self.window or sum(steps for steps, _ in updates) >= self.horizon

    def metrics(self) -> dict[str, float]:
        """`train/<key>` for each of KEYS, and how many episodes they stand for; no key without an episode."""
        if not self.updates:
            return {}
        total = torch.stack([sums for _, sums in self.updates]).sum(0).tolist()
        if not total[0]:
            return {}
        return {"train/episodes": total[0]} | {
            f"train/{key}": value / total[0] for key, value in zip(KEYS, total[1:], strict=True)
        }

    def state_dict(self) -> dict[str, Any]:
        return {"updates": list(self.updates)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.updates = deque(state["updates"])
