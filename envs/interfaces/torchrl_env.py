"""The world as a TorchRL environment: batch-locked, one group of homogeneous agents."""

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from envs.formation import FormationEnv
from envs.interfaces.stream import EpisodeStream, flatten
from envs.spec import Observation


class TorchRLFormationEnv(EnvBase):
    """Teams of quadrotors that keep a formation along +y among columns and thrown balls, as TorchRL agents.

    ## Description
    The task of :class:`envs.interfaces.gymnasium_env.GymnasiumFormationVectorEnv`; root batch size (E,), one group
    ``agents`` of N drones built alike (``group_map``), keys as in TorchRL's own multi-agent environments:

    | key | shape | content |
    |---|---|---|
    | ("agents", "action") | (E, N, 4) | roll, pitch, yaw rate, thrust in [-1, 1] |
    | ("agents", "observation") | (E, N, d) | one vector per drone, see ``envs.interfaces.stream``; with ``flat`` |
    | ("agents", "observation", GROUP) | (E, N, ...) | the groups and masks of ``envs.observation``; without ``flat`` |
    | ("agents", "reward") | (E, N, 1) | weights . reward vector; only if weights are given |
    | ("agents", "reward_vector") | (E, N, 4) | formation, flight, obstacle, action |
    | "done", "terminated", "truncated" | (E, 1) | shared by the team; truncated is the time limit |

    ## Episodes
    They come from a stream of scenarios drawn ``block`` at a time from ``seed``; a partial reset takes the next ones.
    ``hits_terminate``: collisions end episodes, as in training, not only crashes.

    ## Arguments
    ``env`` the world on either physics, ``episodes`` E, ``seed``, ``weights`` (formation, flight, obstacle, action),
    ``hits_terminate``, ``flat``, ``block``. Steps can be differentiated: nothing is detached.
    ``formctl.environments.make_torchrl("mixed", 64)`` builds one from a scenario's name.

    ## Versions
    v0: first version.
    """

    def __init__(
        self,
        env: FormationEnv,
        episodes: int,
        seed: int = 0,
        weights: Sequence[float] | None = None,
        hits_terminate: bool = True,
        flat: bool = True,
        block: int = 1024,
    ) -> None:
        super().__init__(device=env.device, batch_size=torch.Size([episodes]))
        self.env, self.flat = env, flat
        self.weights = None if weights is None else torch.tensor(tuple(weights), dtype=env.dtype, device=env.device)
        self.group_map = {"agents": [f"drone_{i}" for i in range(env.drones)]}
        self.stream = EpisodeStream(env, episodes, seed, hits_terminate, block)
        self._declare(self.stream.observe())

    def _declare(self, observation: Observation) -> None:
        """Specifications of everything that goes in and out, from one observation."""
        team, drones = self.batch_size, torch.Size([*self.batch_size, self.env.drones])
        kind = {"dtype": self.env.dtype, "device": self.device}
        seen: Unbounded | Composite = Unbounded(shape=tuple(flatten(observation).shape), **kind)
        if not self.flat:
            groups = {name: self._group(value) for name, value in observation.items()}
            seen = Composite(groups, shape=drones, device=self.device)
        self.observation_spec = self._agents(observation=seen)
        self.action_spec = self._agents(action=Bounded(-1.0, 1.0, shape=(*drones, 4), **kind))
        rewards = {"reward_vector": Unbounded(shape=(*drones, 4), **kind)}
        if self.weights is not None:
            rewards["reward"] = Unbounded(shape=(*drones, 1), **kind)
        self.reward_spec = self._agents(**rewards)
        flag = Categorical(2, shape=(*team, 1), dtype=torch.bool, device=self.device)
        self.done_spec = Composite(
            {name: flag.clone() for name in ("done", "terminated", "truncated")}, shape=team, device=self.device
        )

    def _group(self, value: Tensor) -> Unbounded | Categorical:
        if value.dtype == torch.bool:
            return Categorical(2, shape=value.shape, dtype=torch.bool, device=self.device)
        return Unbounded(shape=value.shape, dtype=value.dtype, device=self.device)

    def _agents(self, **leaves: Composite | Unbounded | Bounded) -> Composite:
        drones = torch.Size([*self.batch_size, self.env.drones])
        agents = Composite(leaves, shape=drones, device=self.device)
        return Composite({"agents": agents}, shape=self.batch_size, device=self.device)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is None:
            self.stream.restart()
        else:
            self.stream.replace(mask.flatten())
        never = torch.zeros(self.batch_size, dtype=torch.bool, device=self.device)
        return self._output({}, self._flags(never, never))

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        done = self.stream.step(tensordict["agents", "action"])
        rewards = {"reward_vector": done.reward}
        if self.weights is not None:
            rewards["reward"] = (done.reward * self.weights).sum(-1, keepdim=True)
        return self._output(rewards, self._flags(done.terminated, done.truncated))

    def _output(self, rewards: dict[str, Tensor], flags: dict[str, Tensor]) -> TensorDict:
        drones = [*self.batch_size, self.env.drones]
        groups = self.stream.observe()
        seen = flatten(groups) if self.flat else TensorDict(dict(groups), drones, self.device)
        agents = TensorDict({"observation": seen, **rewards}, drones, self.device)
        return TensorDict({"agents": agents, **flags}, self.batch_size, self.device)

    def _flags(self, terminated: Tensor, truncated: Tensor) -> dict[str, Tensor]:
        terminated, truncated = terminated[:, None], truncated[:, None]
        return {"done": terminated | truncated, "terminated": terminated, "truncated": truncated}

    def _set_seed(self, seed: int | None) -> None:
        """Start the stream of scenarios anew."""
        self.stream.seed(0 if seed is None else seed)
