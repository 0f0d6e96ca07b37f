"""Environments for other people's learners, by the name of a scenario: Gymnasium, PettingZoo and TorchRL.

    envs = formctl.environments.make_vec("mixed", num_envs=64, overrides=["scenario.columns=5"])

``overrides`` are the words of the command line: any setting of ``conf/`` can be changed, ``weights=`` and ``reward=``
included. Importing this module registers ``formctl/Free-v0``, ``formctl/Static-v0``, ``formctl/Dynamic-v0`` and
``formctl/Mixed-v0`` with Gymnasium where that is installed. The environments themselves are in ``envs.interfaces`` and
take a built world, for ``envs`` knows neither names of scenarios nor YAML; composing is this package's.
"""

from collections.abc import Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from algos.compilation import Compiler
from envs.formation import FormationEnv
from formctl.extras import require
from formctl.settings import Config, build, compose

if TYPE_CHECKING:
    from envs.interfaces.gymnasium_env import GymnasiumFormationEnv, GymnasiumFormationVectorEnv
    from envs.interfaces.pettingzoo_env import PettingZooFormationEnv
    from envs.interfaces.torchrl_env import TorchRLFormationEnv

__all__ = ["SCENARIOS", "make", "make_parallel", "make_torchrl", "make_vec", "make_world"]

SCENARIOS = ("free", "static", "dynamic", "mixed")
"""Scenarios that have an id of their own in Gymnasium."""


def make_world(
    scenario: str = "mixed", overrides: Sequence[str] = (), *, compile: bool = False
) -> tuple[FormationEnv, Config]:
    """The world of a scenario on its configured physics, and the settings it is made of. Raises ConfigError.

    ``compile`` compiles the world with torch.compile: a minute at first, several times faster afterwards.
    """
    config = compose([f"scenario={scenario}", *overrides])
    env = build.environment(build.world(config), config.sim)
    return (env.compiled(Compiler(True)) if compile else env), config


def make_vec(
    scenario: str = "mixed",
    num_envs: int = 1,
    overrides: Sequence[str] = (),
    *,
    compile: bool = False,
    **settings: Any,
) -> "GymnasiumFormationVectorEnv":
    """``num_envs`` teams as a Gymnasium ``VectorEnv``; ``settings`` are its own arguments, e.g. ``seed=3``."""
    require("gymnasium", "interfaces")
    from envs.interfaces.gymnasium_env import GymnasiumFormationVectorEnv

    env, config = make_world(scenario, overrides, compile=compile)
    return GymnasiumFormationVectorEnv(env, num_envs, config.weights, **settings)


def make(
    scenario: str = "mixed", overrides: Sequence[str] = (), *, compile: bool = False, **settings: Any
) -> "GymnasiumFormationEnv":
    """One team as a Gymnasium ``Env``; ``settings`` are its own arguments."""
    require("gymnasium", "interfaces")
    from envs.interfaces.gymnasium_env import GymnasiumFormationEnv

    env, config = make_world(scenario, overrides, compile=compile)
    return GymnasiumFormationEnv(env, config.weights, **settings)


def make_parallel(
    scenario: str = "mixed", overrides: Sequence[str] = (), *, compile: bool = False, **settings: Any
) -> "PettingZooFormationEnv":
    """One team as a PettingZoo ``ParallelEnv``, a drone an agent; ``settings`` are its own arguments."""
    require("pettingzoo", "interfaces")
    from envs.interfaces.pettingzoo_env import PettingZooFormationEnv

    env, config = make_world(scenario, overrides, compile=compile)
    return PettingZooFormationEnv(env, config.weights, **settings)


def make_torchrl(
    scenario: str = "mixed",
    episodes: int = 1,
    overrides: Sequence[str] = (),
    *,
    compile: bool = False,
    **settings: Any,
) -> "TorchRLFormationEnv":
    """``episodes`` teams as a TorchRL ``EnvBase``; ``settings`` are its own arguments."""
    from envs.interfaces.torchrl_env import TorchRLFormationEnv

    env, config = make_world(scenario, overrides, compile=compile)
    return TorchRLFormationEnv(env, episodes, weights=config.weights, **settings)


def _register() -> None:
    """Tell Gymnasium the ids of SCENARIOS."""
    import gymnasium

    for scenario in SCENARIOS:
        gymnasium.register(
            f"formctl/{scenario.capitalize()}-v0",
            entry_point="formctl.environments:make",
            vector_entry_point="formctl.environments:make_vec",
            kwargs={"scenario": scenario},
        )


if find_spec("gymnasium"):
    _register()
