"""Optuna's own samplers on the weight simplex, for those who want to go beyond random search.

A sampler is made anew for every trial, seeded by the study's seed and the trial's number: workers do not repeat each
other, and a resumed study does not repeat itself. What it knows, it reads from the study's finished trials.
"""

from importlib.util import find_spec
from typing import TYPE_CHECKING, cast

import numpy as np
import optuna

from formctl.search.trials import Weights, simplex
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from optuna.samplers import BaseSampler

UNIT = ("u_1", "u_2", "u_3")
"""Coordinates that the samplers see: the unit cube, which ``simplex`` carries to the weights."""


def make(rule: str, seed: int, trial: int) -> "BaseSampler":
    """The sampler ``tpe``, ``cmaes`` or ``nsga2`` for one trial."""
    own = int(np.random.SeedSequence([seed, trial]).generate_state(1)[0])
    if rule == "tpe":
        return optuna.samplers.TPESampler(seed=own, multivariate=True, constant_liar=True)
    if rule == "cmaes":
        if find_spec("cmaes") is None:
            raise StoreError("search.sampler=cmaes needs the package cmaes: pip install 'formctl[samplers]'")
        return optuna.samplers.CmaEsSampler(seed=own, warn_independent_sampling=False)
    return optuna.samplers.NSGAIISampler(seed=own, population_size=16)


def propose(trial: optuna.Trial) -> Weights:
    """The weights of a trial; what was proposed before a crash stays."""
    unit = np.array([trial.suggest_float(name, 0.0, 1.0) for name in UNIT])
    return cast(Weights, tuple(float(weight) for weight in simplex(unit)))
