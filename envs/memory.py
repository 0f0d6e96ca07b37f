"""The order of the world's numbers in memory: episodes innermost, under shapes (E, ...) that read as usual.

The world's own axes hold two to ten numbers. With one of them innermost, vector instructions run half empty; with the
episodes innermost every operation is one long contiguous loop, eager or compiled. PyTorch's pointwise operations keep
the order of what they are given, so only tensors that are made, joined or picked have to be put in order. Exported
graphs keep the plain order.
"""

from collections.abc import Sequence

import torch
from torch import Tensor


def ordered(x: Tensor) -> Tensor:
    """The same tensor (E, ...) with its episodes innermost in memory; ``x`` itself if it is so already."""
    return x if x.dim() < 2 or torch.compiler.is_exporting() else x.movedim(0, -1).contiguous().movedim(-1, 0)


def stack(parts: Sequence[Tensor]) -> Tensor:
    """``torch.stack(parts, -1)`` of tensors that broadcast, (E, ...) each."""
    parts = torch.broadcast_tensors(*parts)
    if parts[0].dim() == 0 or torch.compiler.is_exporting():
        return torch.stack(parts, -1)
    return torch.stack([x.movedim(0, -1) for x in parts], -2).movedim(-1, 0)


def cat(parts: Sequence[Tensor]) -> Tensor:
    """``torch.cat(parts, -1)`` of tensors (E, ..., k)."""
    if parts[0].dim() == 1 or torch.compiler.is_exporting():
        return torch.cat(tuple(parts), -1)
    return torch.cat([x.movedim(0, -1) for x in parts], -2).movedim(-1, 0)
