"""From composed settings to the objects that run: worlds, environments, trainings, seeds."""

import zlib
from typing import TYPE_CHECKING

import numpy as np
import torch

from algos import curriculum
from algos.trainer import TrainSettings
from envs import deployment
from envs.formation import FormationEnv, WorldSpec

if TYPE_CHECKING:
    from baselines.protocol import Agent
    from envs.deployment import DeploySpec
    from formctl.settings import Config


def world(config: "Config") -> WorldSpec:
    """The task that ``config`` describes."""
    return WorldSpec(config.scenario, config.drone, config.observation, config.reward)


def environment(spec: WorldSpec, sim: str, deploy: "DeploySpec | None" = None) -> FormationEnv:
    """The world on its own physics (``torch``) or on MuJoCo's (``mujoco``), with the craft of a deployment if given."""
    kind = FormationEnv
    if sim == "mujoco":
        from envs.mujoco_env import MujocoFormationEnv

        kind = MujocoFormationEnv
    return kind(spec) if deploy is None else deployment.environment(kind, spec, deploy)


def linked(agent: "Agent", env: FormationEnv, deploy: "DeploySpec | None" = None) -> "Agent":
    """The agent as it flies ``env``: itself, or behind the motion capture and radio of a deployment.

    Raises ValueError for a deployment of what commands rotors.
    """
    if deploy is not None and agent.capabilities.command != "ctbr":
        raise ValueError(
            f"{agent.name} commands {agent.capabilities.command} thrusts every {1000 * env.dt:g} ms, which no radio "
            "carries (nor did the paper fly it): leave it out of deployments"
        )
    return agent if deploy is None else deployment.Link(agent, env, deploy)


def training(config: "Config") -> TrainSettings:
    """What the trainer needs to know. Raises ValueError for a budget that cannot hold the curriculum's periods."""
    curriculum.plan(config.curriculum, config.scenario, config.algo, config.train.steps)
    return TrainSettings(
        world=world(config),
        weights=config.weights,
        encoder=config.encoder,
        algo=config.algo,
        curriculum=config.curriculum,
        steps=config.train.steps,
        seed=config.seed,
        compile=config.train.compile,
    )


def held_out_seed(seed: int, purpose: str) -> int:
    """A seed of its own for ``purpose``: evaluation episodes must not be those of the training with the same seed."""
    return int(np.random.SeedSequence([seed, zlib.crc32(purpose.encode())]).generate_state(1)[0])


def use_threads(config: "Config") -> None:
    """Give torch the threads of ``engine.threads``."""
    torch.set_num_threads(config.engine.threads)
