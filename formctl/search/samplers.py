"""Samplers of weight vectors for Optuna: our own, which is a law of (seed, index), and Optuna's, which learn."""

import zlib
from importlib.util import find_spec
from typing import Any, cast

import numpy as np
from optuna import Study, Trial
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.samplers import BaseSampler, CmaEsSampler, NSGAIISampler, RandomSampler, TPESampler
from optuna.trial import FrozenTrial

from envs.vocabulary import Weights
from formctl.search.laws import PARAMETERS, simplex, weights
from formctl.store.files import StoreError

INDEX = "trial"
"""User attribute with the index of a trial; Optuna's number differs where a failed trial was tried once more."""

SPACE: dict[str, BaseDistribution] = {name: FloatDistribution(0.0, 1.0) for name in PARAMETERS}
"""Weights as Optuna sees them; that they sum to 1 is the sampler's business."""

UNIT = ("u_1", "u_2", "u_3")
"""What Optuna's own samplers see instead: the unit cube, which ``simplex`` carries to the weights."""


class WeightSampler(BaseSampler):
    """The weights of trial k from the study's seed and k alone: no order, crash or other trial changes them.

    Any other parameter of the study is drawn uniformly, from seed, k and its name.
    """

    def __init__(self, seed: int = 0, law: str = "dirichlet") -> None:
        self.seed, self.law = seed, law

    def infer_relative_search_space(self, study: Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """The weights, which are drawn together."""
        return dict(SPACE)

    def sample_relative(
        self, study: Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """The weights of the trial's index."""
        vector = weights(self.seed, self._index(trial), self.law)
        return {name: value for name, value in zip(PARAMETERS, vector, strict=True) if name in search_space}

    def sample_independent(
        self, study: Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution
    ) -> Any:
        """A parameter that is no weight."""
        entropy = [self.seed, self._index(trial), zlib.crc32(param_name.encode())]
        seed = int(np.random.SeedSequence(entropy).generate_state(1)[0])
        return RandomSampler(seed).sample_independent(study, trial, param_name, param_distribution)

    def _index(self, trial: FrozenTrial) -> int:
        return int(trial.user_attrs.get(INDEX, trial.number))


def guided(rule: str, seed: int, index: int) -> BaseSampler:
    """Optuna's sampler ``tpe``, ``cmaes`` or ``nsga2``, made anew for one trial and seeded by its index.

    So workers do not repeat each other, and a resumed study does not repeat itself. Raises StoreError for ``cmaes``
    without its package.
    """
    own = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
    if rule == "tpe":
        return TPESampler(seed=own, multivariate=True, constant_liar=True)
    if rule == "cmaes":
        if find_spec("cmaes") is None:
            raise StoreError("search.sampler=cmaes needs the package cmaes: pip install 'formctl[samplers]'")
        return CmaEsSampler(seed=own, warn_independent_sampling=False)
    return NSGAIISampler(seed=own, population_size=16)


def propose(trial: Trial) -> Weights:
    """The weights of an asked trial; what was proposed before a crash stays."""
    unit = np.array([trial.suggest_float(name, 0.0, 1.0) for name in UNIT])
    return cast(Weights, tuple(float(weight) for weight in simplex(unit)))
