"""PPO in one file on the Gymnasium interface: a team learns to fly in formation where nothing stands in its way.

    python examples/ppo_gymnasium.py --out free.pt2      # learns, writes the policy
    formctl eval --policy free.pt2 scenario=free         # flies it like any other method

A team is one agent with N x 4 actions; one small network, shared by all drones, maps each drone's vector to its four.
After CleanRL's ``ppo_continuous_action.py`` (Huang et al., JMLR 2022): settings, network, roll-out, loss, update.
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

ENVS, ROLLOUT, EPOCHS, MINIBATCHES = 128, 32, 4, 8
GAMMA, TRACE, CLIP, LEARNING_RATE, ENTROPY, GRADIENT_NORM = 0.99, 0.95, 0.2, 1e-3, 0.0, 0.5
REWARD_SCALE = 0.1


class Actor(nn.Module):
    """Commands (B, N, 4) of drones that see (B, N, d); ``mean`` is theirs before tanh."""

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


def train(steps: int, seed: int, log: Path | None, envs: int = ENVS) -> tuple[Actor, list[dict[str, float]]]:
    """Learn for ``steps`` steps of all teams together; the actor and the curve."""
    torch.manual_seed(seed)
    teams = environments.make_vec("free", envs, ["reward=shaped"], seed=seed, autoreset_mode="SameStep")
    drones, width = teams.single_observation_space.shape
    actor, critic = Actor(width), network(width, 1, gain=1.0)
    optimiser = torch.optim.Adam([*actor.parameters(), *critic.parameters()], LEARNING_RATE, eps=1e-5)
    updates = max(1, steps // (envs * ROLLOUT))
    rows = (ROLLOUT, envs)
    seen, drawn = torch.zeros(*rows, drones, width), torch.zeros(*rows, drones, 4)
    logged, value, reward, ended = (torch.zeros(rows) for _ in range(4))
    curve, began, age = [], time.monotonic(), np.zeros(envs)
    now = torch.as_tensor(teams.reset(seed=seed)[0])
    for update in range(updates):
        optimiser.param_groups[0]["lr"] = LEARNING_RATE * (1 - update / updates)
        lengths, errors, earned = [], [], []
        for t in range(ROLLOUT):  # ---- roll-out
            with torch.no_grad():
                law = actor.spread(now)
                seen[t], drawn[t], value[t] = now, law.sample(), critic(now).mean((1, 2))
                logged[t] = law.log_prob(drawn[t]).sum((1, 2))
            following, gained, terminated, truncated, infos = teams.step(drawn[t].tanh().numpy())
            reward[t] = torch.as_tensor(gained) * REWARD_SCALE
            if truncated.any():  # the time limit is no end of the task: what would have followed counts
                last = torch.as_tensor(np.stack(infos["final_obs"][truncated]))
                with torch.no_grad():
                    reward[t, torch.as_tensor(truncated)] += GAMMA * critic(last).mean((1, 2))
            done = terminated | truncated
            ended[t], now, age = torch.as_tensor(done).float(), torch.as_tensor(following), age + 1
            lengths += age[done].tolist()
            age[done] = 0
            errors.append(infos["formation_error"].mean())
            earned.append(gained.mean())
        with torch.no_grad():  # ---- advantages
            after, gain, advantage = critic(now).mean((1, 2)), torch.zeros(envs), torch.zeros(rows)
            for t in reversed(range(ROLLOUT)):
                alive = 1 - ended[t]
                gain = reward[t] + GAMMA * alive * after - value[t] + GAMMA * TRACE * alive * gain
                advantage[t], after = gain, value[t]
            target = (advantage + value).flatten()
        flat = [x.flatten(0, 1) for x in (seen, drawn, logged, advantage)]
        for _ in range(EPOCHS):  # ---- update
            for chosen in torch.randperm(envs * ROLLOUT).chunk(MINIBATCHES):
                observed, action, before, better = (x[chosen] for x in flat)
                ratio = (actor.spread(observed).log_prob(action).sum((1, 2)) - before).exp()
                better = (better - better.mean()) / (better.std() + 1e-8)
                loss = torch.maximum(-better * ratio, -better * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
                loss = loss + 0.5 * (critic(observed).mean((1, 2)) - target[chosen]).square().mean()
                loss = loss - ENTROPY * actor.log_std.sum()
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_([*actor.parameters(), *critic.parameters()], GRADIENT_NORM)
                optimiser.step()
        curve.append(
            {
                "steps": (update + 1) * envs * ROLLOUT,
                "minutes": (time.monotonic() - began) / 60,
                "reward": float(np.mean(earned)),
                "episode_seconds": float(np.mean(lengths)) * 0.02 if lengths else float("nan"),
                "formation_error": float(np.mean(errors)),
            }
        )
        if log is not None:
            log.write_text("".join(json.dumps(row) + "\n" for row in curve))
        if update % 10 == 0 or update == updates - 1:
            print("  ".join(f"{key} {number:,.2f}" for key, number in curve[-1].items()), flush=True)
    return actor, curve


def main() -> None:
    """Train, and write the policy where ``--out`` says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=400_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--envs", type=int, default=ENVS)
    parser.add_argument("--log", type=Path, help="learning curve, one line of JSON per update")
    parser.add_argument("--out", type=Path, help="policy, ending in .pt2")
    given = parser.parse_args()
    torch.set_num_threads(1)
    actor, curve = train(given.steps, given.seed, given.log, given.envs)
    if given.out is not None:
        env, _ = environments.make_world("free")
        facts = {"name": "ppo_gymnasium", "algo": "ppo", "steps": curve[-1]["steps"], "seed": given.seed}
        exported.save(given.out, actor, env, facts)
        print(f"policy: {given.out}; fly it: formctl eval --policy {given.out} scenario=free")


if __name__ == "__main__":
    main()
