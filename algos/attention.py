"""Multi-head attention over a handful of tokens, written twice with identical numbers, and the small MLPs around it."""

from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention

Kernel = Literal["auto", "broadcast", "sdpa"]


def broadcast_attention(query: Tensor, key: Tensor, value: Tensor, present: Tensor) -> Tensor:
    """Attention as broadcast products: for six tokens on a CPU this compiles to loops that beat any library kernel.

    Args:
        query: (B, Q, H, D).
        key, value: (B, K, H, D).
        present: (B, K) bool, False excludes a key; a row without any key gives zeros, never NaN.
    Returns: (B, Q, H, D).
    """
    absent = ~present[:, None, :, None]
    logits = (query.unsqueeze(2) * key.unsqueeze(1)).sum(-1) * query.shape[-1] ** -0.5  # (B, Q, K, H)
    lowest = torch.finfo(logits.dtype).min
    weights = logits.masked_fill(absent, lowest).softmax(dim=2).masked_fill(absent, 0.0)
    return (weights.unsqueeze(-1) * value.unsqueeze(1)).sum(2)


def sdpa_attention(query: Tensor, key: Tensor, value: Tensor, present: Tensor) -> Tensor:
    """The same numbers from PyTorch's fused kernels (GPU); arguments and result as `broadcast_attention`."""
    anything = present.any(1, keepdim=True)  # (B, 1); fused kernels disagree on rows without any key
    mask = (present | ~anything)[:, None, None, :]
    out = scaled_dot_product_attention(query.transpose(1, 2), key.transpose(1, 2), value.transpose(1, 2), mask)
    return out.transpose(1, 2) * anything[:, :, None, None]


def kernel_for(kind: Kernel, device: torch.device) -> Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]:
    """The attention function for a setting: `auto` means broadcast products where a CPU compiles, else fused.

    Uncompiled, the products' intermediate results go through memory, and the fused kernel is twice as fast.
    """
    if kind == "auto":
        return broadcast_attention if torch.compiler.is_compiling() and device.type == "cpu" else sdpa_attention
    return {"broadcast": broadcast_attention, "sdpa": sdpa_attention}[kind]


class Attention(nn.Module):
    """Multi-head attention of (B, Q, W) queries over (B, K, W) tokens, of which `present` (B, K) bool exist."""

    def __init__(self, width: int, heads: int, kernel: Kernel) -> None:
        super().__init__()
        if width % heads:
            raise ValueError(f"encoder.width={width} is not a multiple of encoder.heads={heads}: change one of the two")
        self.heads = heads
        self.kernel: Kernel = kernel
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.output = nn.Linear(width, width)

    def forward(self, query: Tensor, tokens: Tensor, present: Tensor) -> Tensor:
        q = self.query(query).unflatten(-1, (self.heads, -1))
        k, v = self.key_value(tokens).unflatten(-1, (2, self.heads, -1)).unbind(2)
        attended = kernel_for(self.kernel, query.device)(q, k, v, present)
        return self.output(attended.flatten(-2))


class TokenMlp(nn.Module):
    """What stands in for self-attention in the ablation: the same call, but every token sees only itself."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.mlp = feed_forward(width)

    def forward(self, query: Tensor, tokens: Tensor, present: Tensor) -> Tensor:
        return self.mlp(query)


class FlatMlp(nn.Module):
    """What stands in for cross-attention in the ablation: one MLP over all tokens side by side, their number fixed.

    Absent tokens enter as zeros, so fewer tokens than `count` is the same as some being absent.
    """

    def __init__(self, width: int, count: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(count * width, width), nn.GELU(), nn.Linear(width, width))

    def forward(self, query: Tensor, tokens: Tensor, present: Tensor) -> Tensor:
        return self.mlp((tokens * present.unsqueeze(-1)).flatten(1)).unsqueeze(1)


def feed_forward(width: int) -> nn.Sequential:
    """The release's feed-forward: Linear, GELU, Linear, all of one width."""
    return nn.Sequential(nn.Linear(width, width), nn.GELU(), nn.Linear(width, width))
