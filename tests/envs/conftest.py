"""A world composed from ``conf/`` and helpers to fly it."""

from collections.abc import Callable

import pytest
import torch

from envs.formation import FormationEnv, WorldSpec
from formctl.settings import compose


def make_world(*overrides: str) -> WorldSpec:
    """The world of the composed settings; one step per command, which is quick, unless a drone is named."""
    named = any(word.startswith("drone=") for word in overrides)
    config = compose(overrides if named else ("drone=crazyflie_release", *overrides))
    return WorldSpec(config.scenario, config.drone, config.observation, config.reward)


@pytest.fixture
def make_env() -> Callable[..., FormationEnv]:
    """A float64 environment from Hydra overrides."""

    def make(*overrides: str, dtype: torch.dtype = torch.float64) -> FormationEnv:
        return FormationEnv(make_world(*overrides), dtype=dtype)

    return make
