"""The world as a PettingZoo parallel environment: one team, every drone an agent."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from envs.formation import FormationEnv
from envs.interfaces.gymnasium_env import Observed, array, as_arrays, observation_space
from envs.interfaces.stream import EpisodeStream


class PettingZooFormationEnv(ParallelEnv[str, Any, NDArray[np.float32]]):
    """A team of quadrotors that keeps a formation along +y among columns and thrown balls; every drone is an agent.

    ## Description
    As :class:`envs.interfaces.gymnasium_env.GymnasiumFormationVectorEnv`, for one team. Agents are ``drone_0`` to
    ``drone_{N-1}``, built alike; they start, fly and end together.

    ## Action spaces
    ``Box(-1, 1, (4,))``: roll, pitch and yaw rate (1 is ``drone.rate_limit``, pi rad/s, body frame) and collective
    thrust (-1 none, 1 full scale, clamped to ``drone.thrust_range``).

    ## Observation spaces
    ``Box(-inf, inf, (d,))``: the vector in ``envs.interfaces.stream``; with ``flat=False`` a ``Dict`` of the groups in
    ``envs.observation``. ``state()`` is the team's vectors side by side, (N d,).

    ## Rewards
    Each drone's own weights . (formation, flight, obstacle, action), see ``envs.reward`` and Sec. V-A of the paper; the
    four themselves in ``infos[agent]["reward_vector"]``.

    ## Starting state and episode end
    At rest in formation. Termination for all when any drone crashes or, with ``hits_terminate``, hits something;
    truncation after ``scenario.duration`` (18 s, 900 steps of 20 ms).

    ## Arguments
    ``env`` the world, ``weights`` of the four objectives, ``seed`` of the first episodes, ``hits_terminate``, ``flat``.
    ``formctl.environments.make_parallel("mixed")`` builds one from a scenario's name.

    ## Versions
    v0: first version.
    """

    metadata: ClassVar[dict[str, Any]] = {"name": "formation_v0", "render_modes": [], "is_parallelizable": True}
    render_mode = None

    def __init__(
        self,
        env: FormationEnv,
        weights: Sequence[float],
        seed: int = 0,
        hits_terminate: bool = True,
        flat: bool = True,
    ) -> None:
        self.flat, self.stream = flat, EpisodeStream(env, 1, seed, hits_terminate, block=64)
        self.weights = torch.tensor(tuple(weights), dtype=env.dtype, device=env.device)
        self.possible_agents = [f"drone_{index}" for index in range(env.drones)]
        self.agents = list(self.possible_agents)
        team = observation_space(self.stream, flat)
        self.observation_spaces = {name: _one(team) for name in self.possible_agents}
        self.action_spaces = {name: spaces.Box(-1.0, 1.0, (4,), np.float32) for name in self.possible_agents}
        width = int(np.prod(observation_space(self.stream, flat=True).shape))
        self.state_space = spaces.Box(-np.inf, np.inf, (width,), np.float32)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The space of an agent's commands."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observed], dict[str, dict[str, Any]]]:
        """Start the next episode of the stream, which ``seed`` begins anew."""
        if seed is not None:
            self.stream.seed(seed)
        self.stream.restart()
        self.agents = list(self.possible_agents)
        return self._observed(), {name: {} for name in self.agents}

    @torch.no_grad()
    def step(
        self, actions: dict[str, NDArray[np.float32]]
    ) -> tuple[
        dict[str, Observed], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, NDArray[Any]]]
    ]:
        """Fly the commands (4,) of all agents for one control period.

        Returns observations, rewards, terminations, truncations and infos, each by agent.
        """
        env = self.stream.env
        told = np.stack([actions[name] for name in self.possible_agents])
        done = self.stream.step(torch.as_tensor(told, dtype=env.dtype, device=env.device)[None])
        vectors, rewards = array(done.reward[0]), array((done.reward[0] * self.weights).sum(-1))
        terminated, truncated = bool(done.terminated[0]), bool(done.truncated[0])
        flew = self.possible_agents
        result = (
            self._observed(),
            {name: float(reward) for name, reward in zip(flew, rewards, strict=True)},
            dict.fromkeys(flew, terminated),
            dict.fromkeys(flew, truncated),
            {name: {"reward_vector": vector} for name, vector in zip(flew, vectors, strict=True)},
        )
        if terminated or truncated:
            self.agents = []
        return result

    def state(self) -> NDArray[np.float32]:
        """The vectors of all drones side by side, (N d,): what a central critic may see."""
        seen = as_arrays(self.stream.observe(), flat=True)
        assert isinstance(seen, np.ndarray)
        return seen.reshape(-1)

    def _observed(self) -> dict[str, Observed]:
        seen = as_arrays(self.stream.observe(), self.flat)
        if isinstance(seen, np.ndarray):
            return {name: seen[0, index] for index, name in enumerate(self.possible_agents)}
        return {
            name: {group: x[0, index] for group, x in seen.items()} for index, name in enumerate(self.possible_agents)
        }


def _one(team: spaces.Space[Any]) -> spaces.Space[Any]:
    """The space of one drone, from that of its team."""
    if isinstance(team, spaces.Dict):
        return spaces.Dict({name: _one(space) for name, space in team.spaces.items()})
    shape = tuple(team.shape or ())[1:]
    if isinstance(team, spaces.MultiBinary):
        return spaces.MultiBinary(shape)
    return spaces.Box(-np.inf, np.inf, shape, np.float32)
