"""The spread of each objective of a reward along reference flights: what ``scale`` in ``conf/reward/`` divides by.

    formctl train name=reference scenario=stage1 curriculum=none weights=tuned train.steps=100_000
    python -m tests.benchmarks.objectives --policy runs/train/reference/*/policy.pt reward=smooth

flies training episodes of stage 1 with a policy in the middle of its learning, when weights decide what is learnt next,
exploring as the learner does, and prints the mean and the mean absolute deviation of each objective's sum of terms per
drone and step. (Standard deviations would be those of the few steps beside a ball.)
"""

import argparse

import torch

from algos.policy import Policy
from envs import scenarios
from envs.formation import FormationEnv
from envs.vocabulary import OBJECTIVES
from formctl.settings import build, compose

NOISE = 0.2
"""Standard deviation of the exploration: exp(algo.log_std) of conf/algo/shac.yaml."""


@torch.no_grad()
def spread(env: FormationEnv, policy: Policy, episodes: int, noise: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and mean absolute deviation (4,) of the reward vector over ``episodes`` of ``env`` flown to their end."""
    drawn = scenarios.sample(env.world.scenario, episodes, 0)
    state = env.reset(drawn)
    generator = torch.Generator().manual_seed(0)
    rewards = []
    for _ in range(round(env.world.scenario.duration / env.dt)):
        mean = policy(env.observe(state, drawn))
        action = (mean + noise * torch.randn(mean.shape, generator=generator)).tanh()
        state, reward, _ = env.step(state, action, drawn)
        rewards.append(reward)
    flown = torch.stack(rewards).flatten(0, -2)
    return flown.mean(0), (flown - flown.mean(0)).abs().mean(0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", required=True)
    parser.add_argument("--noise", type=float, default=NOISE)
    parser.add_argument("--episodes", type=int, default=32)
    parser.add_argument("overrides", nargs="*")
    words = parser.parse_args()
    unscaled = [f"reward.scale.{name}=1" for name in OBJECTIVES]
    config = compose(["scenario=stage1", *words.overrides, *unscaled])
    mean, deviation = spread(FormationEnv(build.world(config)), Policy.load(words.policy), words.episodes, words.noise)
    for name, middle, width in zip(OBJECTIVES, mean.tolist(), deviation.tolist(), strict=True):
        print(f"{name:10} mean {middle:8.4f}  spread {width:8.4f}")


if __name__ == "__main__":
    main()
