"""The attention-based observation encoder (paper, Sec. V-C1; release, `PartialAttentionEncoder`, type 3) and ablations.

Differences from the release, each of them a setting or a repaired fault:
- masks are boolean and exclude a token; the release adds +1 to the logits of the tokens it means to ignore;
- embeddings are two-layer MLPs as the paper says (`embedding: linear` is the release's single layer);
- two heads (release: 1; the paper says "multi-head" without a number);
- the ablations replace a module by an MLP, as the paper says; the release drops self-attention altogether.
"""

from dataclasses import dataclass
from typing import Any, Literal, Protocol

import torch
from torch import Tensor, nn

from algos.attention import Attention, FlatMlp, Kernel, TokenMlp, feed_forward
from algos.encoder_op import EncoderOp, encoder_op
from envs.spec import Observation, ObservationLayout


@dataclass(frozen=True)
class EncoderSpec:
    """An encoder (`conf/encoder/`)."""

    name: str
    width: int  # of every token; the encoder gives 2 * width features
    heads: int
    embedding: Literal["mlp", "linear"]
    self_attention: Literal["attention", "mlp"]
    cross_attention: Literal["attention", "mlp"]
    attention: Kernel  # how attention is computed, not what it computes
    initialisation: Literal["orthogonal", "default"]


class Encoder(nn.Module):
    """Observation groups to (..., 2 * width) features, one vector per drone.

    Tokens: self | other drones (N - 1) | balls (M) | columns (1). With `cross_attention: attention` any N and M are
    accepted and the order of drones and balls does not matter.
    """

    def __init__(self, spec: EncoderSpec, layout: ObservationLayout, balls: int) -> None:
        super().__init__()
        self.spec, self.drones, self.balls = spec, layout.drones, balls
        self.features = 2 * spec.width
        dims = {
            "self": layout.self_dim,
            "drones": layout.drones_dim,
            "dynamic": layout.dynamic_dim,
            "static": layout.static_dim,
        }
        self.embed = nn.ModuleDict({group: _embedding(dim, spec) for group, dim in dims.items()})
        self.norm_mix = nn.LayerNorm(spec.width)
        self.mix: nn.Module = (
            Attention(spec.width, spec.heads, spec.attention)
            if spec.self_attention == "attention"
            else TokenMlp(spec.width)
        )
        self.norm_tokens = nn.LayerNorm(spec.width)
        self.feed_tokens = feed_forward(spec.width)
        self.norm_shared = nn.LayerNorm(spec.width)
        self.gather: nn.Module = (
            Attention(spec.width, spec.heads, spec.attention)
            if spec.cross_attention == "attention"
            else FlatMlp(spec.width, layout.drones - 1 + balls + 1)
        )
        self.norm_pair = nn.LayerNorm(spec.width)
        self.feed_pair = feed_forward(spec.width)
        if spec.initialisation == "orthogonal":
            self.apply(_orthogonal)

    @property
    def op(self) -> EncoderOp | None:
        """The C++ operator that does the same, where `attention: auto` may choose it and it can be built."""
        spec, example = self.spec, self.norm_mix.weight
        mlp = "mlp" in (spec.self_attention, spec.cross_attention)
        if spec.attention != "auto" or mlp or example.device.type != "cpu" or example.dtype != torch.float32:
            return None
        return encoder_op(spec.width, spec.heads, spec.embedding == "mlp")

    def gathered(self) -> Tensor:
        """All parameters, one behind the other, as the operator reads them; gradients reach them through it."""
        return torch.cat([parameter.flatten() for parameter in self.parameters()])

    def forward(self, observation: Observation, gathered: Tensor | None = None) -> Tensor:
        """Features (..., 2 * width); `gathered` saves gathering the parameters, which several calls can share."""
        compiling = torch.compiler.is_compiling() or torch.jit.is_tracing()
        if not compiling and observation["self"].dtype == torch.float32 and (op := self.op):
            return op(observation, self.gathered() if gathered is None else gathered)
        batch = observation["self"].shape[:-2]
        groups = self._groups(observation)
        present = torch.cat([mask for _, mask in groups.values()], -1).flatten(0, -2)  # (B, T)
        x = torch.cat([self.embed[name](tokens) for name, (tokens, _) in groups.items()], -2).flatten(0, -3)
        x = x.masked_fill(~present.unsqueeze(-1), 0.0)

        normed = self.norm_mix(x)
        x = x + self.mix(normed, normed, present)
        x = x + self.feed_tokens(self.norm_tokens(x))

        normed = self.norm_shared(x)
        own, others = normed[:, :1], normed[:, 1:]
        own_token = x[:, :1]
        pair = torch.cat([own_token, own_token + self.gather(own, others, present[:, 1:])], 1)  # (B, 2, W)
        pair = pair + self.feed_pair(self.norm_pair(pair))
        return pair.flatten(1).unflatten(0, batch)

    def _groups(self, observation: Observation) -> dict[str, tuple[Tensor, Tensor]]:
        """Tokens and masks by group, in token order; with a fixed token count, missing balls become absent tokens."""
        own, drones, dynamic = observation["self"], observation["drones"], observation["dynamic"]
        dynamic_mask = observation["dynamic_mask"]
        if self.spec.cross_attention == "mlp":
            self._check_counts(drones.shape[-2] + 1, dynamic.shape[-2])
            missing = self.balls - dynamic.shape[-2]
            dynamic = nn.functional.pad(dynamic, (0, 0, 0, missing))
            dynamic_mask = nn.functional.pad(dynamic_mask, (0, missing))
        return {
            "self": (own, _everywhere(own)),
            "drones": (drones, _everywhere(drones)),
            "dynamic": (dynamic, dynamic_mask),
            "static": (observation["static"], observation["static_mask"]),
        }

    def _check_counts(self, drones: int, balls: int) -> None:
        if drones != self.drones or balls > self.balls:
            raise ValueError(
                f"encoder={self.spec.name} has no cross-attention: it was built for {self.drones} drones and at most "
                f"{self.balls} balls, not {drones} drones and {balls} balls; use encoder=attention or train it with "
                f"scenario.balls={balls}"
            )


class ForeignEncoderSpec(Protocol):
    """Settings of an encoder that a method brings along: a module from observation groups to `features` numbers."""

    @property
    def name(self) -> str: ...

    def build(self, layout: ObservationLayout) -> Any: ...


def build_encoder(spec: EncoderSpec | ForeignEncoderSpec, layout: ObservationLayout, balls: int = 0) -> Any:
    """An encoder for a layout. `balls` is the largest number it will see; only encoders without cross-attention care.

    Raises ValueError when width and heads do not fit.
    """
    return Encoder(spec, layout, balls) if isinstance(spec, EncoderSpec) else spec.build(layout)


def _embedding(dim: int, spec: EncoderSpec) -> nn.Module:
    if spec.embedding == "linear":
        return nn.Linear(dim, spec.width)
    return nn.Sequential(nn.Linear(dim, spec.width), nn.ELU(), nn.Linear(spec.width, spec.width))


def _everywhere(tokens: Tensor) -> Tensor:
    return torch.ones(tokens.shape[:-1], dtype=torch.bool, device=tokens.device)


def _orthogonal(module: nn.Module) -> None:
    if isinstance(module, nn.Linear):
        nn.init.orthogonal_(module.weight)
        nn.init.zeros_(module.bias)
