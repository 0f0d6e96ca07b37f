"""From a first guess to a local trajectory: L-BFGS over waypoints and times."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from baselines.planner.interface import Array
from baselines.swarm_formation.costs import Problem, objective
from baselines.swarm_formation.minco import Polynomial, connect, stretch, unstretch

SHORTEST = 0.05
"""s, least duration of a piece in a first guess."""


class Guess(NamedTuple):
    """Where the search for a trajectory begins."""

    waypoints: Array  # (P - 1, 3) m
    durations: Array  # (P,) s


def optimise(problem: Problem, guess: Guess, iterations: int, tolerance: float) -> Polynomial:
    """The trajectory after at most ``iterations`` of L-BFGS (memory 16), or once |gradient| <= tolerance max(1, |x|).

    How the search ended is ignored, as in the published code: the trajectory is judged, not the optimiser.
    """
    pieces = len(guess.durations)
    first = np.concatenate((guess.waypoints.ravel(), unstretch(np.maximum(guess.durations, SHORTEST))))
    gradient = np.empty_like(first)
    slopes: dict[bytes, float] = {}

    def cost(free: Array) -> tuple[float, Array]:
        value = objective(free, problem, gradient)
        slopes[free.tobytes()] = float(np.linalg.norm(gradient))
        return value, gradient.copy()

    def settled(free: Array) -> None:
        if slopes[free.tobytes()] <= tolerance * max(1.0, float(np.linalg.norm(free))):
            raise StopIteration

    options = {"maxcor": 16, "maxiter": iterations, "maxls": 40, "ftol": 0.0, "gtol": 0.0}
    free = minimize(cost, first, jac=True, method="L-BFGS-B", callback=settled, options=options).x
    durations = np.array([stretch(time) for time in free[3 * pieces - 3 :]])
    waypoints = free[: 3 * pieces - 3].reshape(-1, 3)
    return Polynomial(problem.start, durations, connect(problem.head, problem.tail, waypoints, durations))
