"""GAE and PPO's loss against TorchRL's, value loss and normaliser against values worked out by hand."""

import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import ProbabilisticTensorDictModule, ProbabilisticTensorDictSequential, TensorDictModule
from torch import nn
from torch.distributions import Independent, Normal
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value.functional import generalized_advantage_estimate

from algos.gae import advantages
from algos.losses import clipped_policy_loss, clipped_value_loss, gaussian_entropy, gaussian_log_prob
from algos.value_norm import ValueNorm


def test_gae_equals_torchrl() -> None:
    steps, envs, drones = 20, 6, 3
    reward, value, next_value = (torch.randn(steps, envs, drones, dtype=torch.float64) for _ in range(3))
    done = torch.rand(steps, envs) < 0.2
    terminated = done & (torch.rand(steps, envs) < 0.5)
    assert terminated.any() and (done & ~terminated).any()
    ours = advantages(reward, value, next_value, terminated, done, 0.97, 0.9)

    def rows(x: torch.Tensor) -> torch.Tensor:  # TorchRL: (..., T, features)
        return x.transpose(0, 1)

    wide = [rows(x.unsqueeze(-1).expand(-1, -1, drones)) for x in (done, terminated)]
    theirs, target = generalized_advantage_estimate(
        0.97, 0.9, rows(value), rows(next_value), rows(reward), done=wide[0], terminated=wide[1]
    )
    torch.testing.assert_close(rows(ours), theirs, rtol=1e-5, atol=1e-5)  # TorchRL discounts in float32
    torch.testing.assert_close(rows(ours + value), target, rtol=1e-5, atol=1e-5)


def test_policy_loss_and_log_prob_equal_torchrl() -> None:
    mean, log_std = nn.Linear(5, 4), torch.tensor([-0.5, 0.0, 0.3, -1.0])
    actor = ProbabilisticTensorDictSequential(
        TensorDictModule(lambda x: (mean(x), log_std.exp().expand(*x.shape[:-1], 4)), ["obs"], ["loc", "scale"]),
        ProbabilisticTensorDictModule(
            ["loc", "scale"], ["action"], distribution_class=lambda loc, scale: Independent(Normal(loc, scale), 1)
        ),
    )
    obs, u, advantage = torch.randn(64, 5), torch.randn(64, 4), torch.randn(64)
    log_prob = gaussian_log_prob((u - mean(obs)) / log_std.exp(), log_std)
    old = (log_prob + 0.4 * torch.randn(64)).detach()
    loss = ClipPPOLoss(actor, None, clip_epsilon=0.2, entropy_bonus=False, critic_coeff=None)
    loss.set_keys(sample_log_prob="old")
    data = TensorDict({"obs": obs, "action": u, "old": old, "advantage": advantage.unsqueeze(-1)}, 64)
    torch.testing.assert_close(clipped_policy_loss(log_prob, old, advantage, 0.2), loss(data)["loss_objective"])
    distribution = Independent(Normal(torch.zeros(4), log_std.exp()), 1)
    torch.testing.assert_close(gaussian_entropy(log_std), distribution.entropy())


def test_value_loss_by_hand() -> None:
    value, old, target = torch.tensor([1.0, 0.0]), torch.tensor([0.0, 0.0]), torch.tensor([1.0, 2.0])
    # unclipped errors 0 and 2; the first value may only move to 0.2: clipped errors 0.8 and 2
    elementwise = clipped_value_loss(value, old, target, 0.2, 10.0, "elementwise")
    assert elementwise.item() == pytest.approx((0.5 * 0.8**2 + 0.5 * 2**2) / 2)
    target = torch.tensor([1.0, -0.1])
    value = torch.tensor([1.0, 1.0])  # unclipped 0 and 1.1, clipped 0.8 and 0.3
    elementwise = clipped_value_loss(value, old, target, 0.2, 10.0, "elementwise")
    means = clipped_value_loss(value, old, target, 0.2, 10.0, "batch_means")
    assert elementwise.item() == pytest.approx((0.5 * 0.8**2 + 0.5 * 1.1**2) / 2)
    assert means.item() == pytest.approx(0.5 * 1.1**2 / 2)
    assert clipped_value_loss(value, value, target, 0.2, 1.0, "elementwise").item() == pytest.approx((1.1 - 0.5) / 2)


def test_value_norm_is_unbiased_from_the_first_batch_and_inverts() -> None:
    norm, returns = ValueNorm(0.995, 1e-2), 30 + 5 * torch.randn(10_000)
    assert torch.equal(norm.denormalise(norm.normalise(returns)), returns)  # nothing known yet: the identity
    norm.update(returns)
    normal = norm.normalise(returns)
    assert normal.mean().abs() < 1e-3 and abs(normal.std() - 1) < 1e-3
    torch.testing.assert_close(norm.denormalise(normal), returns)


def test_value_norm_follows_the_exponential_average_and_keeps_its_floor() -> None:
    norm = ValueNorm(0.9, 1e-2)
    norm.update(torch.tensor([0.0]))
    norm.update(torch.tensor([1.0]))
    mean, deviation = norm.statistics()
    assert mean.item() == pytest.approx(0.1 / 0.19)
    assert deviation.item() == pytest.approx(math.sqrt(0.1 / 0.19 - (0.1 / 0.19) ** 2))
    flat = ValueNorm(0.9, 1e-2)
    flat.update(torch.full((5,), 3.0))
    assert flat.statistics()[1].item() == pytest.approx(0.1)
