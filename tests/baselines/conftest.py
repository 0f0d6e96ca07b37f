"""Environments and agents composed from ``conf/``."""

from collections.abc import Callable
from functools import cache

import pytest
import torch

from baselines import registry
from baselines.protocol import Agent
from envs.formation import FormationEnv, WorldSpec
from formctl.evaluation.methods import located
from formctl.settings import Config
from formctl.settings import compose as compose_afresh


@cache
def compose(*overrides: str) -> Config:
    """The composed settings, once per set of overrides."""
    return compose_afresh(overrides)


@pytest.fixture
def make_env() -> Callable[..., FormationEnv]:
    """An environment from Hydra overrides."""

    def make(*overrides: str, dtype: torch.dtype = torch.float64) -> FormationEnv:
        config = compose(*overrides)
        world = WorldSpec(config.scenario, config.drone, config.observation, config.reward)
        return FormationEnv(world, dtype=dtype)

    return make


@pytest.fixture
def make_agent() -> Callable[..., Agent]:
    """A baseline by name, with its settings from ``conf/baseline/`` and overrides."""

    def make(name: str, env: FormationEnv, *overrides: str) -> Agent:
        settings = compose(f"baseline={name}", *overrides).baseline
        assert settings is not None
        return registry.make(name, env, located(settings))

    return make
