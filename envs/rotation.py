"""Quaternions ``wxyz``, body to world, and norms whose gradient is finite at zero."""

import torch
from torch import Tensor

from envs import memory

EPSILON = 1e-12
"""Added under square roots: distances of zero have gradient zero instead of NaN."""


def norm(vector: Tensor, keepdim: bool = False) -> Tensor:
    """Euclidean length over the last axis; zero gradient at zero."""
    return (vector.square().sum(-1, keepdim=keepdim) + EPSILON).sqrt()


def multiply(left: Tensor, right: Tensor) -> Tensor:
    """Hamilton product of quaternions (..., 4)."""
    a, b, c, d = left.unbind(-1)
    e, f, g, h = right.unbind(-1)
    return memory.stack(
        (
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        )
    )


def exponential(rotation_vector: Tensor) -> Tensor:
    """Quaternion (..., 4) of a rotation vector (..., 3) in rad."""
    angle = norm(rotation_vector, keepdim=True)
    return memory.cat(((angle / 2).cos(), rotation_vector * (angle / 2).sin() / angle))


def logarithm(quaternion: Tensor) -> Tensor:
    """Rotation vector (..., 3) in rad of a quaternion, the shorter way round: the inverse of ``exponential``."""
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    sine = norm(quaternion[..., 1:], keepdim=True)
    return quaternion[..., 1:] * 2 * torch.atan2(sine, quaternion[..., :1]) / sine


def conjugate(quaternion: Tensor) -> Tensor:
    """The inverse of unit quaternions (..., 4)."""
    return quaternion * quaternion.new_tensor([1.0, -1.0, -1.0, -1.0])


def heading_axis(quaternion: Tensor) -> Tensor:
    """Body x in the world frame, R e_x (..., 3)."""
    w, x, y, z = quaternion.unbind(-1)
    return memory.stack((1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)))


def left_axis(quaternion: Tensor) -> Tensor:
    """Body y in the world frame, R e_y (..., 3)."""
    w, x, y, z = quaternion.unbind(-1)
    return memory.stack((2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)))


def up_axis(quaternion: Tensor) -> Tensor:
    """Body z in the world frame, R e_z (..., 3): the direction of thrust."""
    w, x, y, z = quaternion.unbind(-1)
    return memory.stack((2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)))


def from_roll_pitch_yaw(angles: Tensor) -> Tensor:
    """Quaternion (..., 4) of roll, pitch, yaw (..., 3) in rad, applied yaw first (intrinsic z-y-x)."""
    half = angles / 2
    zero = torch.zeros_like(half[..., 0])
    roll, pitch, yaw = half.unbind(-1)
    about_x = memory.stack((roll.cos(), roll.sin(), zero, zero))
    about_y = memory.stack((pitch.cos(), zero, pitch.sin(), zero))
    about_z = memory.stack((yaw.cos(), zero, zero, yaw.sin()))
    return multiply(about_z, multiply(about_y, about_x))
