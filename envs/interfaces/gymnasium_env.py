"""The world as Gymnasium environments: a batch of teams, or one, each team being one agent."""

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torch import Tensor

from envs.formation import FormationEnv
from envs.interfaces.stream import GROUPS, EpisodeStream, Transition, flatten
from envs.spec import Observation

Observed = NDArray[np.float32] | dict[str, NDArray[Any]]
"""What an agent is given: one array, or an array per group."""


class GymnasiumFormationVectorEnv(VectorEnv[Any, NDArray[np.float32], NDArray[Any]]):
    """Teams of quadrotors that keep a formation along +y among columns and thrown balls, ``num_envs`` teams at once.

    ## Description
    A team of N drones (three) starts at rest in formation and is to fly along +y at v* = 2 m/s, 1.5 m high, through a
    field of columns from y = 2 to 34 m, while balls are thrown at it (paper, Sec. III and V-A). All teams advance in
    one batched step. A team is one agent with N x 4 actions; weights shared by all drones act on the second axis.

    ## Action space
    ``Box(-1, 1, (N, 4))`` per team. With ``drone.command`` CTBR, per drone:

    | index | meaning | -1 | 0 | 1 | frame |
    |---|---|---|---|---|---|
    | 0, 1, 2 | roll, pitch and yaw rate | -pi rad/s | 0 | pi rad/s | body |
    | 3 | collective thrust, share of full scale | 0 | 0.5 | 1, clamped to ``drone.thrust_range`` | body z |

    ## Observation space
    ``Box(-inf, inf, (N, d))`` per team: the vector of each drone in ``envs.interfaces.stream``. With ``flat=False`` a
    ``Dict`` of the groups in ``envs.observation``, e.g. ``self`` (N, 1, 25) and ``dynamic_mask`` (N, M); a group
    without numbers (balls where there are none) is left out.

    ## Rewards
    Mean over the team of weights . (formation, flight, obstacle, action), see ``envs.reward`` and Sec. V-A of the
    paper. ``info["reward_vector"]`` (E, N, 4) has the four themselves, ``info["formation_error"]`` (E,) the
    unnormalised Laplacian distance in m.

    ## Starting state
    At rest in formation at the origin, 1.5 m high, rotors at hover; columns and throws are drawn anew.

    ## Episode end
    Termination: a drone below 0.2 m or above 2.8 m or, with ``hits_terminate``, within ``scenario.hit_radius`` of a
    column's axis, a flying ball's centre or another drone's. Truncation: after ``scenario.duration`` (18 s, 900 steps
    of 20 ms).

    ## Autoreset
    ``autoreset_mode`` is Gymnasium's: the default next-step, where the action after an end is ignored; same-step, with
    ``info["final_obs"]``; or disabled, where ``reset(options={"reset_mask": mask})`` starts episodes.

    ## Arguments
    ``env`` the world, ``num_envs`` E, ``weights`` of the four objectives, ``seed`` of the first episodes,
    ``hits_terminate``, ``flat``, ``autoreset_mode``. ``reset(seed=...)`` restarts the stream of scenarios; a list of
    seeds is one seed made of many. By id: ``gymnasium.make_vec("formctl/Mixed-v0", num_envs=64)`` after
    ``import formctl.environments``, which also says how settings are changed.

    ## Versions
    v0: first version.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        env: FormationEnv,
        num_envs: int,
        weights: Sequence[float],
        seed: int = 0,
        hits_terminate: bool = True,
        flat: bool = True,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        self.num_envs, self.flat = num_envs, flat
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = self.metadata | {
            "autoreset_mode": self.autoreset_mode,
            "render_fps": round(1 / env.dt),
        }
        self.stream = EpisodeStream(env, num_envs, seed, hits_terminate)
        self.weights = torch.tensor(tuple(weights), dtype=env.dtype, device=env.device)
        self.single_observation_space = observation_space(self.stream, flat)
        self.single_action_space = spaces.Box(-1.0, 1.0, (env.drones, 4), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = torch.zeros(num_envs, dtype=torch.bool, device=env.device)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Start every episode, or those of ``options["reset_mask"]`` (E,) bool."""
        if seed is not None:
            self.stream.seed(one_seed(seed))
        mask = (options or {}).get("reset_mask")
        if mask is None:
            self.stream.restart()
            self._ended = torch.zeros_like(self._ended)
        else:
            chosen = torch.as_tensor(mask, device=self._ended.device)
            self.stream.replace(chosen)
            self._ended = self._ended & ~chosen
        return self._observed(), {}

    @torch.no_grad()
    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Observed, NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Fly ``actions`` (E, N, 4) for one control period.

        Returns observations, rewards (E,), terminations (E,), truncations (E,) and infos.
        """
        env = self.stream.env
        done = self.stream.step(torch.as_tensor(actions, dtype=env.dtype, device=env.device))
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            done = self._restarted(done)
        ended = done.terminated | done.truncated
        infos = step_infos(done)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            if bool(ended.any()):
                infos |= self._final(ended, infos)
            self.stream.replace(ended)
        self._ended = ended
        reward = (done.reward * self.weights).sum(-1).mean(-1)
        return self._observed(), array(reward), array(done.terminated), array(done.truncated), infos

    def _restarted(self, done: Transition) -> Transition:
        """Episodes that ended in the step before start now: no reward, no end, whatever their drones did meanwhile."""
        fresh = self._ended
        self.stream.replace(fresh)
        return done._replace(
            reward=torch.where(fresh[:, None, None], 0.0, done.reward),
            terminated=done.terminated & ~fresh,
            truncated=done.truncated & ~fresh,
        )

    def _final(self, ended: Tensor, infos: dict[str, Any]) -> dict[str, Any]:
        """What was seen where episodes ended, as Gymnasium's same-step autoreset reports it."""
        seen, mask = self._observed(), array(ended)
        final = np.full(self.num_envs, None, dtype=object)
        for index in np.flatnonzero(mask):
            final[index] = seen[index] if self.flat else {name: x[index] for name, x in seen.items()}
        return {"final_obs": final, "_final_obs": mask, "final_info": dict(infos), "_final_info": mask}

    def _observed(self) -> Observed:
        return as_arrays(self.stream.observe(), self.flat)


class GymnasiumFormationEnv(gymnasium.Env[Any, NDArray[np.float32]]):
    """One team: :class:`GymnasiumFormationVectorEnv`, which documents it, for what flies one environment at a time.

    The batched environment flies a thousand teams in the time that this one takes for a dozen.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(
        self,
        env: FormationEnv,
        weights: Sequence[float],
        seed: int = 0,
        hits_terminate: bool = True,
        flat: bool = True,
    ) -> None:
        self.flat, self.stream = flat, EpisodeStream(env, 1, seed, hits_terminate, block=64)
        self.metadata = self.metadata | {"render_fps": round(1 / env.dt)}
        self.weights = torch.tensor(tuple(weights), dtype=env.dtype, device=env.device)
        self.observation_space = observation_space(self.stream, flat)
        self.action_space = spaces.Box(-1.0, 1.0, (env.drones, 4), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Start the next episode of the stream, which ``seed`` begins anew."""
        super().reset(seed=seed)
        if seed is not None:
            self.stream.seed(seed)
        self.stream.restart()
        return self._observed(), {}

    @torch.no_grad()
    def step(self, action: NDArray[np.float32]) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Fly ``action`` (N, 4) for one control period."""
        env = self.stream.env
        done = self.stream.step(torch.as_tensor(action, dtype=env.dtype, device=env.device)[None])
        reward = float((done.reward * self.weights).sum(-1).mean())
        infos = {"reward_vector": array(done.reward[0]), "formation_error": float(done.events.formation_error[0])}
        return self._observed(), reward, bool(done.terminated[0]), bool(done.truncated[0]), infos

    def _observed(self) -> Observed:
        seen = as_arrays(self.stream.observe(), self.flat)
        return seen[0] if self.flat else {name: x[0] for name, x in seen.items()}


def observation_space(stream: EpisodeStream, flat: bool) -> spaces.Space[Any]:
    """The space of one team: ``Box`` (N, d), or a ``Dict`` of groups (N, tokens, numbers) and masks (N, tokens)."""
    seen = stream.observe()
    if flat:
        return spaces.Box(-np.inf, np.inf, tuple(flatten(seen).shape[1:]), np.float32)
    groups: dict[str, spaces.Space[Any]] = {}
    for name in _present(seen):
        shape = tuple(seen[name].shape[1:])
        mask = seen[name].dtype == torch.bool
        groups[name] = spaces.MultiBinary(shape) if mask else spaces.Box(-np.inf, np.inf, shape, np.float32)
    return spaces.Dict(groups)


def as_arrays(seen: Observation, flat: bool) -> Observed:
    """Observations as numpy arrays: one (E, N, d), or one for each group."""
    if flat:
        return array(flatten(seen))
    groups = {name: seen[name] for name in _present(seen)}
    return {name: array(x.to(torch.int8) if x.dtype == torch.bool else x) for name, x in groups.items()}


def _present(seen: Observation) -> list[str]:
    """The groups that hold any number, in their order."""
    return [name for name in GROUPS if seen[name].numel()]


def step_infos(done: Transition) -> dict[str, Any]:
    """What a step of every episode comes to beside its reward, each with Gymnasium's mask of who has it."""
    found = {"reward_vector": array(done.reward), "formation_error": array(done.events.formation_error)}
    everybody = np.ones(len(done.terminated), dtype=bool)
    return found | {f"_{name}": everybody for name in found}


def array(x: Tensor) -> NDArray[Any]:
    """A tensor as a contiguous array of its own: float32, or its own kind where it holds no real numbers."""
    kind = torch.float32 if x.is_floating_point() else x.dtype
    return np.array(x.detach().to("cpu", kind).numpy(), order="C", copy=True)


def one_seed(seed: int | Sequence[int | None]) -> int:
    """One seed out of one, or out of a list of them."""
    if isinstance(seed, int | np.integer):
        return int(seed)
    return int(np.random.SeedSequence([0 if one is None else one for one in seed]).generate_state(1)[0])
