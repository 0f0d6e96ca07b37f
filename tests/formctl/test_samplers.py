"""Our sampler is one that Optuna's own conformance suite accepts; its weights follow from seed and index alone."""

import optuna
import pytest
from optuna.testing.pytest_samplers import BasicSamplerTestCase

from formctl.search import laws
from formctl.search.samplers import SPACE, WeightSampler


class TestConformance(BasicSamplerTestCase):
    """Optuna's suite for third-party samplers."""

    @pytest.fixture
    def sampler(self):
        return lambda: WeightSampler(seed=7)


@pytest.mark.parametrize("law", sorted(laws.LAWS))
def test_weights_follow_from_seed_and_index(law):
    study = optuna.create_study(sampler=WeightSampler(seed=7, law=law))
    asked = [study.ask(SPACE) for _ in range(3)]
    for number in (2, 0, 1):
        study.tell(asked[number], 0.5)
    assert [tuple(trial.params.values()) for trial in study.trials] == [laws.weights(7, k, law) for k in range(3)]


def test_the_index_counts_not_optunas_number():
    sampler = WeightSampler(seed=7)
    trial = optuna.trial.create_trial(state=optuna.trial.TrialState.RUNNING, user_attrs={"trial": 4})
    found = sampler.sample_relative(optuna.create_study(), trial, SPACE)
    assert tuple(found.values()) == laws.weights(7, 4, "dirichlet")
