"""How long a plan may take: the least time of a double integrator, axis by axis (MADER, Sec. V-A)."""

import numpy as np

from baselines.planner.interface import Array


def least_time(distance: Array, speed: Array, speed_limit: float, acceleration_limit: float) -> Array:
    """Seconds from ``speed`` (m/s) to rest ``distance`` (m) further, at bounded speed and acceleration; any shape.

    With s the side that the stopping point is short on, v = s speed, D = s distance and the peak
    p = sqrt(v^2 / 2 + a D): (2 p - v) / a where p is within the limit, else (V - v) / a + v^2 / (2 a V) + D / V.
    """
    a, most = acceleration_limit, speed_limit
    side = np.where(distance >= speed * np.abs(speed) / (2 * a), 1.0, -1.0)
    v, d = side * speed, side * distance
    peak = np.sqrt(np.maximum(v**2 / 2 + a * d, 0.0))
    return np.where(peak <= most, (2 * peak - v) / a, (most - v) / a + v**2 / (2 * a * most) + d / most)


def longest_interval(velocity: Array, acceleration: Array, speed_limit: float) -> float:
    """Longest interval in s that keeps the second velocity control point, v0 + a0 interval / 2, within the limit.

    0 where the start is too fast already: there is no plan from there.
    """
    room = speed_limit - np.where(acceleration >= 0, velocity, -velocity)
    if (np.abs(velocity) > speed_limit).any():
        return 0.0
    push = np.abs(acceleration)
    return float(np.min(2 * room / np.maximum(push, 1e-12)))
