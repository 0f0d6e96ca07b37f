"""Running normalisation of returns, so that the critic's targets keep a size that any reward weights agree with."""

from collections.abc import Callable

import torch
from torch import Tensor, nn


class ValueNorm(nn.Module):
    """Debiased exponential mean and variance of the returns (release, `learning/utils/valuenorm.py`).

    The critic speaks in normalised units: `denormalise` its outputs before GAE, `normalise` the returns it learns.
    """

    mean: Tensor
    square: Tensor
    weight: Tensor

    def __init__(self, decay: float, variance_floor: float) -> None:
        """`decay` per update (release: 0.995); `variance_floor` keeps constant returns from exploding (1e-2)."""
        super().__init__()
        self.decay, self.variance_floor = decay, variance_floor
        for name in ("mean", "square", "weight"):  # weight is the share of data among mean and square: the debiasing
            self.register_buffer(name, torch.zeros((), dtype=torch.float64))

    def update(self, returns: Tensor, mean: Callable[[Tensor], Tensor] = lambda moments: moments) -> None:
        """Take in one batch of returns, of any shape; `mean` averages its moments (2,) over processes."""
        batch = returns.detach().double()
        first, second = mean(torch.stack((batch.mean(), batch.square().mean())))
        self.mean.lerp_(first, 1 - self.decay)
        self.square.lerp_(second, 1 - self.decay)
        self.weight.lerp_(torch.ones_like(self.weight), 1 - self.decay)

    def statistics(self) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation; (0, 1) before the first update."""
        if self.weight == 0:
            return torch.zeros_like(self.mean), torch.ones_like(self.mean)
        mean = self.mean / self.weight
        variance = (self.square / self.weight - mean.square()).clamp(min=self.variance_floor)
        return mean, variance.sqrt()

    def adopt(self, mean: float, deviation: float) -> None:
        """Go on from known statistics."""
        self.mean.fill_(mean)
        self.square.fill_(mean**2 + deviation**2)
        self.weight.fill_(1.0)

    def normalise(self, returns: Tensor) -> Tensor:
        mean, deviation = self.statistics()
        return (returns - mean.to(returns.dtype)) / deviation.to(returns.dtype)

    def denormalise(self, values: Tensor) -> Tensor:
        mean, deviation = self.statistics()
        return values * deviation.to(values.dtype) + mean.to(values.dtype)
