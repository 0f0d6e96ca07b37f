"""Generalised advantage estimation (Schulman et al. 2016) for a team that ends together."""

import torch
from torch import Tensor


def advantages(
    reward: Tensor, value: Tensor, next_value: Tensor, terminated: Tensor, done: Tensor, gamma: float, decay: float
) -> Tensor:
    """Advantages (T, E, N) of T steps in E environments of N drones; returns are advantages + value.

    TorchRL's GAE gives the same numbers (tested); this one takes the (T, E, N) layout without a TensorDict round-trip
    and keeps the 5 s import of torchrl out of every training process.

    Args:
        reward, value: (T, E, N), value of the state acted in.
        next_value: (T, E, N), value of the state reached, *before* any reset; ignored where terminated.
        terminated: (T, E) bool, nothing follows.
        done: (T, E) bool, the episode ended here, terminated or at its time limit; the estimate does not look past it.
    """
    follows = (~terminated).unsqueeze(-1).to(reward.dtype)
    continues = (~done).unsqueeze(-1).to(reward.dtype)
    delta = reward + gamma * follows * next_value - value
    result = torch.empty_like(delta)
    running = torch.zeros_like(delta[0])
    for t in reversed(range(len(delta))):
        running = delta[t] + gamma * decay * continues[t] * running
        result[t] = running
    return result
