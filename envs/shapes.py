"""Formation shapes: slots (N, 3) of a formation around its reference point."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from envs.spec import ScenarioSpec

POLYGONS = {"triangle": 3, "square": 4, "pentagon": 5, "hexagon": 6}
REAL = ((-1.0, 0.0, 0.0), (0.0, -0.6, 0.0), (0.0, 0.6, 0.0))
"""The formation of the real flights (release: ``REAL_TRIANGLE``)."""


def slots(spec: ScenarioSpec, dtype: torch.dtype = torch.float32) -> Tensor:
    """Offsets (N, 3) in m of each drone's slot. ValueError for an unknown name or fewer than two points.

    Named polygons have their first vertex at +x and circumradius ``formation_size``; ``triangle`` is the release's.
    """
    shape = spec.formation
    if isinstance(shape, str):
        if shape == "real":
            points = [list(point) for point in REAL]
        elif shape in POLYGONS:
            turn = 2 * math.pi / POLYGONS[shape]
            points = [[math.cos(turn * k), math.sin(turn * k), 0.0] for k in range(POLYGONS[shape])]
        else:
            choices = ", ".join((*POLYGONS, "real"))
            raise ValueError(f"unknown formation '{shape}': use one of {choices}, or a list of [x, y, z] points")
    else:
        points = [list(point) for point in shape]
    if len(points) < 2:
        raise ValueError("a formation needs at least two drones: scenario.formation lists fewer points")
    return spec.formation_size * torch.tensor(points, dtype=dtype)


def distances(position: Tensor) -> Tensor:
    """Pairwise distances (..., N, N) in m with a zero diagonal; finite gradients everywhere."""
    squared = (position[..., :, None, :] - position[..., None, :, :]).square().sum(-1)
    identity = torch.eye(position.shape[-2], dtype=position.dtype, device=position.device)
    return (squared + identity).sqrt() * (1 - identity)


class Laplacian(NamedTuple):
    """A formation (..., N, 3) as its graph: what the two Laplacian distances compare."""

    distances: Tensor  # (..., N, N) m, the adjacency A
    degrees: Tensor  # (..., N) m, D
    normalised: Tensor  # (..., N, N), D^(-1/2) A D^(-1/2)


def laplacian(position: Tensor) -> Laplacian:
    """Graph of the drones at ``position`` (..., N, 3) with plain (not squared) distances as weights."""
    adjacency = distances(position)
    degrees = adjacency.sum(-1)
    scale = (degrees + 1e-9).rsqrt()
    return Laplacian(adjacency, degrees, adjacency * scale[..., :, None] * scale[..., None, :])


def laplacian_distances(position: Tensor, target: Laplacian) -> tuple[Tensor, Tensor]:
    """Unnormalised and normalised Laplacian distance (...,) of drones (..., N, 3) from a target formation.

    The unnormalised Laplacian is diag(D) - A, the normalised one I - D^(-1/2) A D^(-1/2); distances are Frobenius
    norms. The first is FM (Sec. VI-A1) and blind to rotation and translation; the second is the training shape error
    (Sec. V-A) and blind to size as well. The release broadcasts D instead of placing it on the diagonal, which is
    the same for three drones only.
    """
    actual = laplacian(position)
    size = (actual.degrees - target.degrees).square().sum(-1)
    size = size + (actual.distances - target.distances).square().sum((-1, -2))
    shape = (actual.normalised - target.normalised).square().sum((-1, -2))
    return (size + 1e-12).sqrt(), (shape + 1e-12).sqrt()
