"""What the learners train: the policy and, for training only, a value of what each drone sees."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import torch
from torch import Tensor, nn

from algos.compilation import Compiler
from algos.encoder import build_encoder
from algos.learner import Problem
from algos.policy import Policy
from envs.dynamics import hover_action
from envs.spec import Observation

P = ParamSpec("P")
R = TypeVar("R")


class ActorCritic(nn.Module):
    """The policy and a value per drone, from separate encoders (release) or from one."""

    def __init__(self, problem: Problem, log_std: float, share_encoder: bool) -> None:
        super().__init__()
        self.policy = Policy(
            problem.encoder,
            problem.layout,
            problem.observation,
            problem.drone.name,
            problem.balls,
            log_std,
            hover_action(problem.drone),
            problem.drone.command,
        )
        self.encoder = None if share_encoder else build_encoder(problem.encoder, problem.layout, problem.balls)
        self.value = nn.Linear(self.policy.encoder.features, 1)
        nn.init.orthogonal_(self.value.weight, 0.01)
        nn.init.zeros_(self.value.bias)

    def forward(self, observation: Observation) -> tuple[Tensor, Tensor]:
        """Mean of u (..., N, 4) and value (..., N) in normalised units."""
        features = self.policy.encoder(observation)
        seen = features if self.encoder is None else self.encoder(observation)
        return self.policy.head(features), self.value(seen).squeeze(-1)

    def critic(self, observation: Observation) -> Tensor:
        """Value (..., N) alone."""
        return self.value((self.encoder or self.policy.encoder)(observation)).squeeze(-1)

    def compiler_for(self, compiler: Compiler) -> Callable[[Callable[P, R]], Callable[P, R]]:
        """What to compile functions of these networks with: nothing, where their encoder is one operator already."""
        return compiler if getattr(self.policy.encoder, "op", None) is None else lambda function: function

    def parts(self) -> list[list[nn.Parameter]]:
        """Parameters by optimiser: actor and critic, or all together when they share the encoder."""
        if self.encoder is None:
            return [list(self.parameters())]
        return [list(self.policy.parameters()), [*self.encoder.parameters(), *self.value.parameters()]]

    def inherit(self, other: "ActorCritic") -> bool:
        """Take over another's policy, and its critic where both have an encoder of its own or both have none.

        Returns whether the critic came along.
        """
        alike = (self.encoder is None) == (other.encoder is None)
        if alike:
            self.load_state_dict(other.state_dict())
        else:
            self.policy.load_state_dict(other.policy.state_dict())
        return alike

    def adopt(self, policy: Policy) -> None:
        """Go on with a policy trained elsewhere; the critic stays. Raises ValueError where it is built otherwise."""
        try:
            self.policy.load_state_dict(policy.state_dict())
        except RuntimeError as error:
            ours, theirs = self.policy.encoder_spec.name, policy.encoder_spec.name
            raise ValueError(
                f"the policy to start from is built otherwise (encoder={theirs}, {policy.balls} balls, "
                f"observation={policy.layout.name}; here encoder={ours}, {self.policy.balls} balls, "
                f"observation={self.policy.layout.name})"
            ) from error

    @torch.no_grad()
    def rescale(self, mean: float, deviation: float) -> None:
        """Let the critic say mean + deviation * what it says now."""
        self.value.weight.mul_(deviation)
        self.value.bias.mul_(deviation).add_(mean)
