"""The attention encoder of Swarm-RL (Huang et al. 2023, Sec. III-C) and the actor that is flown.

With the published sizes, two neighbours and no balls, encoder, mean and spread of the actor and encoder and value of
its critic have 3,304,969 parameters together. Balls, which only this task has, are a third token.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from envs.spec import Observation, ObservationLayout

TOKENS = ("drones", "static", "dynamic")
"""Groups that attend to each other; those of width zero are left out."""


@dataclass(frozen=True)
class SwarmRlEncoderSpec:
    """Sizes of the encoder (``conf/encoder/swarm_rl*.yaml``)."""

    name: str
    width: int  # of every token and hidden layer
    layers: int  # of each group's perceptron
    heads: int
    key_width: int  # of keys, queries and values, per head
    features: int  # of the encoder

    def build(self, layout: ObservationLayout) -> "SwarmRlEncoder":
        """A fresh encoder for a layout."""
        return SwarmRlEncoder(self, layout)


class SwarmRlEncoder(nn.Module):
    """Observation groups to (..., features), one vector per drone: perceptrons, attention among tokens, one layer."""

    def __init__(self, spec: SwarmRlEncoderSpec, layout: ObservationLayout) -> None:
        super().__init__()
        widths = {"drones": layout.drones_dim, "static": layout.static_dim, "dynamic": layout.dynamic_dim}
        self.tokens = [group for group in TOKENS if widths[group]]
        self.features = spec.features
        self.own = _perceptron(layout.self_dim, spec)
        self.embed = nn.ModuleDict({group: _perceptron(widths[group], spec) for group in self.tokens})
        self.attend = SelfAttention(spec)
        self.norm = nn.LayerNorm(spec.width, eps=1e-6)
        self.join = nn.Sequential(nn.Linear((1 + len(self.tokens)) * spec.width, spec.features), nn.Tanh())
        self.apply(_xavier)

    def forward(self, observation: Observation) -> Tensor:
        own = self.own(observation["self"].squeeze(-2))
        tokens = torch.stack([self.embed[group](observation[group].squeeze(-2)) for group in self.tokens], -2)
        tokens = self.norm(tokens + self.attend(tokens))
        return self.join(torch.cat((own, tokens.flatten(-2)), -1))


class SelfAttention(nn.Module):
    """Scaled dot-product attention of tokens (..., T, width) among themselves, without biases."""

    def __init__(self, spec: SwarmRlEncoderSpec) -> None:
        super().__init__()
        self.heads, inner = spec.heads, spec.heads * spec.key_width
        self.query, self.key, self.value = (nn.Linear(spec.width, inner, bias=False) for _ in range(3))
        self.out = nn.Linear(inner, spec.width, bias=False)

    def forward(self, tokens: Tensor) -> Tensor:
        query, key, value = (
            layer(tokens).unflatten(-1, (self.heads, -1)) for layer in (self.query, self.key, self.value)
        )  # (..., T, heads, key_width)
        products = (query.unsqueeze(-3) * key.unsqueeze(-4)).sum(-1)  # (..., T, T, heads): query, key
        share = (products / math.sqrt(query.shape[-1])).softmax(-2)
        seen = (share.unsqueeze(-1) * value.unsqueeze(-4)).sum(-3)
        return self.out(seen.flatten(-2))


class SwarmRlActor(nn.Module):
    """The network as it is flown; its parameters are those of a policy file."""

    def __init__(self, spec: SwarmRlEncoderSpec, layout: ObservationLayout) -> None:
        super().__init__()
        self.encoder = spec.build(layout)
        self.head = nn.Linear(spec.features, 4)
        self.log_std = nn.Parameter(torch.zeros(4))

    @torch.no_grad()
    def forward(self, observation: Observation) -> Tensor:
        """Rotor thrusts (..., 4) in [-1, 1]."""
        dtype = self.head.weight.dtype
        return self.head(self.encoder({name: x.to(dtype) for name, x in observation.items()})).tanh()


def _perceptron(inputs: int, spec: SwarmRlEncoderSpec) -> nn.Sequential:
    widths = [inputs, *[spec.width] * spec.layers]
    layers = [[nn.Linear(*pair), nn.Tanh()] for pair in pairwise(widths)]
    return nn.Sequential(*(part for layer in layers for part in layer))


def _xavier(module: nn.Module) -> None:
    if isinstance(module, nn.Linear):
        nn.init.xavier_uniform_(module.weight)
        if module.bias is not None:
            nn.init.zeros_(module.bias)
