"""PPO in one file on the PettingZoo interface: three drones that share one network learn to fly in formation.

    python examples/ppo_pettingzoo.py --out free.pt2     # learns, writes the policy
    formctl eval --policy free.pt2 scenario=free         # flies it like any other method

Every drone is an agent with its own reward (independent PPO with shared parameters). One team flies at a time, so the
world is compiled: a minute of compiling, then ten times the speed. Settings, network, roll-out, advantages, update.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from baselines import exported
from formctl import environments

ROLLOUT, EPOCHS, MINIBATCHES = 2048, 6, 12
GAMMA, TRACE, CLIP, LEARNING_RATE, GRADIENT_NORM = 0.99, 0.95, 0.2, 1e-3, 0.5
REWARD_SCALE = 0.1


class Actor(nn.Module):
    """Commands (..., 4) of drones that see (..., d); ``mean`` is theirs before tanh."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.mean = network(width, 4, gain=0.01)
        self.log_std = nn.Parameter(torch.full((4,), -0.7))

    def forward(self, seen: Tensor) -> Tensor:
        return self.mean(seen).tanh()

    def spread(self, seen: Tensor) -> torch.distributions.Normal:
        """The law of the commands before tanh, which belongs to the world."""
        return torch.distributions.Normal(self.mean(seen), self.log_std.exp())


def network(width: int, out: int, gain: float) -> nn.Sequential:
    """Two hidden layers of 64, initialised orthogonally."""
    layers = [nn.Linear(width, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, out)]
    for layer, scale in zip(layers[::2], (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


def train(
    steps: int, seed: int, log: Path | None, compile: bool = True, rollout: int = ROLLOUT
) -> tuple[Actor, list[dict[str, float]]]:
    """Learn for ``steps`` steps of the team; the actor and the curve."""
    torch.manual_seed(seed)
    team = environments.make_parallel("free", ["reward=shaped"], seed=seed, compile=compile)
    names = team.possible_agents
    (width,) = team.observation_space(names[0]).shape
    actor, critic = Actor(width), network(width, 1, gain=1.0)
    optimiser = torch.optim.Adam([*actor.parameters(), *critic.parameters()], LEARNING_RATE, eps=1e-5)
    rows, updates = (rollout, len(names)), max(1, steps // rollout)
    seen, drawn = torch.zeros(*rows, width), torch.zeros(*rows, 4)
    logged, value, reward = (torch.zeros(rows) for _ in range(3))
    ended = torch.zeros(rollout, 1)
    curve, began, age = [], time.monotonic(), 0
    now = beside(team.reset(seed=seed)[0], names)
    for update in range(updates):
        optimiser.param_groups[0]["lr"] = LEARNING_RATE * (1 - update / updates)
        lengths = []
        for t in range(rollout):  # ---- roll-out
            with torch.no_grad():
                law = actor.spread(now)
                seen[t], drawn[t], value[t] = now, law.sample(), critic(now).squeeze(-1)
                logged[t] = law.log_prob(drawn[t]).sum(-1)
            told = dict(zip(names, drawn[t].tanh().numpy(), strict=True))
            following, gained, _, truncated, _ = team.step(told)
            now, age = beside(following, names), age + 1
            reward[t] = torch.tensor([gained[name] for name in names]) * REWARD_SCALE
            if truncated[names[0]]:  # the time limit is no end of the task: what would have followed counts
                with torch.no_grad():
                    reward[t] += GAMMA * critic(now).squeeze(-1)
            ended[t] = float(not team.agents)
            if not team.agents:
                lengths, age = [*lengths, age], 0
                now = beside(team.reset()[0], names)
        with torch.no_grad():  # ---- advantages
            after, gain, advantage = critic(now).squeeze(-1), torch.zeros(len(names)), torch.zeros(rows)
            for t in reversed(range(rollout)):
                alive = 1 - ended[t]
                gain = reward[t] + GAMMA * alive * after - value[t] + GAMMA * TRACE * alive * gain
                advantage[t], after = gain, value[t]
            target = (advantage + value).flatten()
        flat = [x.flatten(0, 1) for x in (seen, drawn, logged, advantage)]
        for _ in range(EPOCHS):  # ---- update
            for chosen in torch.randperm(len(target)).chunk(MINIBATCHES):
                observed, action, before, better = (x[chosen] for x in flat)
                ratio = (actor.spread(observed).log_prob(action).sum(-1) - before).exp()
                better = (better - better.mean()) / (better.std() + 1e-8)
                loss = torch.maximum(-better * ratio, -better * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
                loss = loss + 0.5 * (critic(observed).squeeze(-1) - target[chosen]).square().mean()
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_([*actor.parameters(), *critic.parameters()], GRADIENT_NORM)
                optimiser.step()
        curve.append(
            {
                "steps": (update + 1) * rollout,
                "minutes": (time.monotonic() - began) / 60,
                "reward": float(reward.mean()) / REWARD_SCALE,
                "episode_seconds": float(np.mean(lengths)) * 0.02 if lengths else float("nan"),
            }
        )
        if log is not None:
            log.write_text("".join(json.dumps(row) + "\n" for row in curve))
        if update % 10 == 0 or update == updates - 1:
            print("  ".join(f"{key} {number:,.2f}" for key, number in curve[-1].items()), flush=True)
    return actor, curve


def beside(by_name: dict[str, np.ndarray], names: list[str]) -> Tensor:
    """What all drones see, (N, d), in the order of ``names``."""
    return torch.as_tensor(np.stack([by_name[name] for name in names]))


def main() -> None:
    """Train, and write the policy where ``--out`` says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=80_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rollout", type=int, default=ROLLOUT)
    parser.add_argument("--eager", action="store_true", help="do not compile the world")
    parser.add_argument("--log", type=Path, help="learning curve, one line of JSON per update")
    parser.add_argument("--out", type=Path, help="policy, ending in .pt2")
    given = parser.parse_args()
    torch.set_num_threads(1)
    actor, curve = train(given.steps, given.seed, given.log, not given.eager, given.rollout)
    if given.out is not None:
        env, _ = environments.make_world("free")
        facts = {"name": "ppo_pettingzoo", "algo": "ppo", "steps": curve[-1]["steps"], "seed": given.seed}
        exported.save(given.out, actor, env, facts)
        print(f"policy: {given.out}; fly it: formctl eval --policy {given.out} scenario=free")


if __name__ == "__main__":
    main()
