"""Which weights a trial gets: laws that take (study seed, index of the trial) and nothing else (paper, Sec. V-B)."""

from collections.abc import Callable

import numpy as np

from envs.vocabulary import OBJECTIVES, Weights
from formctl.store.files import StoreError

PARAMETERS = tuple(f"w_{name}" for name in OBJECTIVES)
"""Names of the weights in a study: formation, flight, obstacle, action."""

GUIDED = ("tpe", "cmaes", "nsga2")
"""Optuna's own samplers, which are no laws: what they propose depends on the trials that are finished by then."""


def _dirichlet(seed: int, index: int) -> np.ndarray:
    """Uniform on the simplex."""
    return _generator(seed, index).dirichlet(np.ones(len(PARAMETERS)))


def _release(seed: int, index: int) -> np.ndarray:
    """Four uniforms divided by their sum: what the authors' stage-1 script draws."""
    uniforms = _generator(seed, index).uniform(size=len(PARAMETERS))
    return np.asarray(uniforms / uniforms.sum())


def _sobol(seed: int, index: int) -> np.ndarray:
    """Point ``index`` of a scrambled Sobol sequence, carried to the simplex: it fills more evenly than chance does."""
    from scipy.stats import qmc  # takes a second, and only this law needs it

    sequence = qmc.Sobol(len(PARAMETERS) - 1, scramble=True, rng=np.random.default_rng(np.random.SeedSequence([seed])))
    if index:
        sequence.fast_forward(index)
    return simplex(sequence.random(1)[0])


def _generator(seed: int, index: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence([seed, index]))


LAWS: dict[str, Callable[[int, int], np.ndarray]] = {"dirichlet": _dirichlet, "release": _release, "sobol": _sobol}
"""Weights (4,) from (study seed, index) alone."""


def simplex(unit: np.ndarray) -> np.ndarray:
    """A point of the unit cube (n,) as a point of the simplex (n + 1,); uniform goes to uniform (stick-breaking)."""
    rest, parts = 1.0, []
    for left, share in zip(range(len(unit), 0, -1), unit, strict=True):
        kept = (1.0 - share) ** (1.0 / left)
        parts.append(rest * (1.0 - kept))
        rest *= kept
    return np.array([*parts, rest])


def weights(seed: int, index: int, law: str) -> Weights:
    """Weights of trial ``index`` in the order of PARAMETERS; they sum to 1. Raises StoreError for an unknown law."""
    if law not in LAWS:
        raise StoreError(f"search.sampler={law} is unknown; choose one of: {', '.join((*LAWS, *GUIDED))}")
    formation, flight, obstacle, action = (float(value) for value in LAWS[law](seed, index))
    return formation, flight, obstacle, action
