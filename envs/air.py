"""Wind and gusts: drawn before the flight as a few plane waves, and then a function of place and time.

Steady wind is horizontal and the same everywhere. Gusts are Dryden turbulence near the ground (MIL-F-8785C; the forms
of MIL-HDBK-1797 are the same spectra with other lengths), frozen into the air and carried along by the wind: a sum of
waves whose wave numbers are spread so that each carries the same share of the energy. What a drone meets then has
Dryden's spectrum at the speed at which the formation flies through the air, and neighbours meet the same gusts. Air
acts on a drone through its damping (``envs.dynamics``); rotors blow no harder or weaker in it.
"""

import math

import numpy as np
import torch
from torch import Tensor

from envs.spec import AirSpec, ScenarioSpec

WAVES = 16
"""Waves of each component: along the wind, across it and upwards."""

FOOT = 0.3048
"""m."""

LOWEST = 10.0
"""ft, the lowest height the turbulence model is made for; lower flights meet the gusts of this height."""

ROUGHNESS = 0.15
"""ft, of the ground under the steady wind's profile."""


def wind_at_20_feet(speed: Tensor, height: float) -> Tensor:
    """The wind in 20 feet (m/s), which measures turbulence, of a wind with ``speed`` in m/s at ``height`` in m.

    W = W20 ln(h / 0.15 ft) / ln(20 ft / 0.15 ft) (MIL-F-8785C, 3.7.3.4).
    """
    feet = max(height / FOOT, 3.0)
    return speed * math.log(20 / ROUGHNESS) / math.log(feet / ROUGHNESS)


def turbulence(height: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Lengths in m and intensities as shares of the wind in 20 feet, along the wind, across it and upwards.

    Below 1000 ft (MIL-F-8785C, 3.7.3.4): L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2; sigma_w = 0.1 W20,
    sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4, with h in ft.
    """
    feet = max(height / FOOT, LOWEST)
    ratio = 0.177 + 0.000823 * feet
    long, strong = feet * FOOT / ratio**1.2, 0.1 / ratio**0.4
    return (long, long, feet * FOOT), (strong, strong, 0.1)


def along_wave_numbers(share: Tensor) -> Tensor:
    """Wave number times length below which ``share`` of the energy of Dryden's gusts along the wind lies.

    The inverse of 2/pi atan(x), the integral of 2/pi 1 / (1 + x^2).
    """
    return (math.pi / 2 * share).tan()


def across_wave_numbers(share: Tensor) -> Tensor:
    """The same across the wind and upwards: the inverse of (2 atan(x) - x / (1 + x^2)) / pi, by a table.

    That is the integral of 1/pi (1 + 3 x^2) / (1 + x^2)^2.
    """
    angle = np.linspace(0, math.pi / 2, 4097)
    below = (2 * angle - np.sin(angle) * np.cos(angle)) / math.pi
    return torch.from_numpy(np.tan(np.interp(share.numpy(), below, angle)))


def draw(spec: AirSpec, scenario: ScenarioSpec, count: int, generator: np.random.Generator) -> Tensor:
    """``Scenarios.wind`` of ``count`` flights in float64: (count, 1 + 3 WAVES, 7), or (count, 0, 7) in still air."""
    if spec.wind[1] == 0:
        return torch.zeros(count, 0, 7, dtype=torch.float64)
    numbers = torch.from_numpy(generator.random((count, 2 + 6 * WAVES)))
    low, high = spec.wind
    speed = low + (high - low) * numbers[:, 0]
    heading = 2 * math.pi * numbers[:, 1]
    along = torch.stack((heading.cos(), heading.sin(), torch.zeros_like(heading)), -1)
    across = torch.stack((-heading.sin(), heading.cos(), torch.zeros_like(heading)), -1)
    steady = torch.cat((speed[:, None] * along, torch.zeros(count, 4, dtype=torch.float64)), -1)
    axes = torch.stack((along, across, torch.tensor([0.0, 0.0, 1.0]).expand_as(along)), 1)  # (count, 3, 3)
    return torch.cat((steady[:, None], _gusts(spec, scenario, speed, axes, numbers[:, 2:])), 1)


def _gusts(spec: AirSpec, scenario: ScenarioSpec, speed: Tensor, axes: Tensor, numbers: Tensor) -> Tensor:
    """Waves (count, 3 WAVES, 7): each component's energy in WAVES equal shares, one wave anywhere in each."""
    place, phase = numbers.unflatten(1, (3, WAVES, 2)).unbind(-1)  # (count, 3, WAVES)
    share = ((torch.arange(WAVES) + place) / WAVES).clamp_max(0.999)
    lengths, strengths = (torch.tensor(part, dtype=torch.float64) for part in turbulence(scenario.height))
    number = torch.stack([along_wave_numbers(share[:, 0]), *map(across_wave_numbers, share[:, 1:].unbind(1))], 1)
    number = number / lengths[:, None]  # rad/m
    through = torch.tensor(scenario.velocity, dtype=torch.float64) - speed[:, None] * axes[:, 0]  # flight through air
    through = through / torch.linalg.vector_norm(through, dim=-1, keepdim=True).clamp_min(1e-9)
    strength = spec.gusts * wind_at_20_feet(speed, scenario.height)[:, None] * strengths * math.sqrt(2 / WAVES)
    amplitude = (strength[..., None] * axes)[:, :, None].expand(-1, -1, WAVES, -1)
    waves = (amplitude, number[..., None] * through[:, None, None], 2 * math.pi * phase[..., None])
    return torch.cat(waves, -1).flatten(1, 2)


def velocity(waves: Tensor, position: Tensor, time: Tensor) -> Tensor:
    """Velocity (E, N, 3) in m/s of the air at ``position`` (E, N, 3) in m and ``time`` (E,) in s.

    ``waves`` are ``Scenarios.wind``: amplitude cos(wave vector . (position - steady wind time) + phase), the steady
    wind being the wave of length zero.
    """
    amplitude, vector, phase = waves.split((3, 3, 1), -1)
    carried = position - (amplitude[:, :1] * time[:, None, None])
    angle = (carried[:, :, None] * vector[:, None]).sum(-1) + phase[:, None, :, 0]  # (E, N, 1 + G)
    return (angle.cos()[..., None] * amplitude[:, None]).sum(2)
