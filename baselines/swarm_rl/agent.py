"""Swarm-RL as an agent: the trained network, four rotor thrusts per drone, 100 times a second."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from baselines.protocol import Capabilities
from baselines.swarm_rl.network import SwarmRlActor, SwarmRlEncoderSpec
from baselines.swarm_rl.observation import SwarmRlObservation
from envs.formation import FormationEnv
from envs.spec import ObservationLayout, Scenarios, State


@dataclass(frozen=True)
class SwarmRlSpec:
    """Settings of :class:`SwarmRl` (``conf/baseline/swarm_rl.yaml``)."""

    policy: str  # file
    published_steps: int  # environment steps of the published training
    deviations: tuple[str, ...]  # sentences: where this differs from the published method


class SwarmRl:
    """Huang et al. 2023 with the paper's adaptations. Every drone decides alone; the mean of its policy is flown."""

    capabilities = Capabilities(
        command="rotor", batched=True, needs_ball_parameters=False, max_drones=None, min_drones=3, period=0.01
    )

    def __init__(self, name: str, env: FormationEnv, spec: SwarmRlSpec) -> None:
        """Raises ValueError for a policy that is none of Swarm-RL's, and for another control period."""
        self.name, self.env = name, env
        period = self.capabilities.period
        if period is not None and abs(env.dt - period) > 1e-9:
            raise ValueError(
                f"baseline '{name}' commands every {period:g} s, this world takes a command every {env.dt:g} s: "
                f"use drone.control_period={period:g}"
            )
        try:
            self.actor, self.sensor, _ = load(spec.policy)
        except ValueError as error:
            raise ValueError(f"baseline '{name}': {error}") from error

    @classmethod
    def training(cls, spec: SwarmRlSpec) -> dict[str, Any]:
        """How long the policy was trained, as far as its file says, and how long the published one."""
        meta = load(spec.policy)[2]
        return {key: meta[key] for key in ("steps", "minutes") if key in meta} | {
            "published_steps": spec.published_steps
        }

    def reset(self, scenarios: Scenarios, state: State) -> None:
        """Nothing to prepare: the policy has no memory."""

    def act(self, state: State, scenarios: Scenarios) -> Tensor:
        """Rotor thrusts (E, N, 4) in [-1, 1] for the next 10 ms."""
        time, world = self.env.time(state), self.env.world.scenario
        observation = self.sensor.observe(state, scenarios, time, world, self.env.slots)
        return self.actor(observation).to(state.position.dtype)


def load(policy: str) -> tuple[SwarmRlActor, SwarmRlObservation, dict[str, Any]]:
    """The network of a policy file, what it sees, and the facts of its training. Raises ValueError, one line.

    ``policy`` is a file that ``formctl train experiment=swarm_rl`` has written.
    """
    path = Path(policy).expanduser()
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)["content"]
        spec, seen = SwarmRlEncoderSpec(**content["encoder"]), SwarmRlObservation(**content["observation"])
        actor = SwarmRlActor(spec, ObservationLayout(**content["layout"]))
        actor.load_state_dict(content["weights"])
    except FileNotFoundError as error:
        raise ValueError(f"there is no policy {path}: train one with formctl train experiment=swarm_rl") from error
    except Exception as error:  # torch raises a dozen types for damaged zips and pickles
        raise ValueError(f"{path} is damaged, or no policy of formctl train experiment=swarm_rl") from error
    return actor.eval(), seen, content["meta"]
