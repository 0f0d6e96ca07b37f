"""The losses of MAPPO as pure functions of tensors (Yu et al. 2022; release, `omni_drones/learning/mappo.py`)."""

import math
from typing import Literal

import torch
from torch import Tensor
from torch.nn.functional import huber_loss

ValueLoss = Literal["elementwise", "batch_means"]


def gaussian_log_prob(standard: Tensor, log_std: Tensor) -> Tensor:
    """Log density (...,) of u = mean + exp(log_std) * standard, standard (..., 4), in the space of u (no tanh term)."""
    return (-0.5 * standard.square() - log_std - 0.5 * math.log(2 * math.pi)).sum(-1)


def gaussian_entropy(log_std: Tensor) -> Tensor:
    """Entropy () of a diagonal Gaussian, in nats."""
    return (log_std + 0.5 * math.log(2 * math.pi * math.e)).sum()


def clipped_policy_loss(log_prob: Tensor, old_log_prob: Tensor, advantage: Tensor, clip: float) -> Tensor:
    """-mean(min(rho A, clip(rho) A)), PPO's surrogate; all arguments of one shape.

    TorchRL's ClipPPOLoss gives the same number (tested); ours compiles together with the network into one graph.
    """
    ratio = (log_prob - old_log_prob).exp()
    return -torch.min(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage).mean()


def clipped_value_loss(
    value: Tensor, old_value: Tensor, target: Tensor, clip: float, delta: float, kind: ValueLoss
) -> Tensor:
    """Huber loss of the critic whose change since the roll-out is clipped, everything in normalised units.

    `elementwise` takes the worse of clipped and unclipped for every sample (PPO2, the MAPPO paper); `batch_means` takes
    the worse of the two batch means, as the release does: there one side loses its gradient for the whole batch.
    """
    clipped = old_value + (value - old_value).clamp(-clip, clip)
    free_loss = huber_loss(value, target, reduction="none", delta=delta)
    clipped_loss = huber_loss(clipped, target, reduction="none", delta=delta)
    if kind == "batch_means":
        return torch.max(free_loss.mean(), clipped_loss.mean())
    return torch.max(free_loss, clipped_loss).mean()
