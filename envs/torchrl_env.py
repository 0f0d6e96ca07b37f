"""The world as a TorchRL environment: batch-locked, one group of homogeneous agents, for use with TorchRL's learners.

Root batch size (E,). Keys, with N drones, as in TorchRL's own multi-agent environments:

| key | shape | content |
|---|---|---|
| ("agents", "action") | (E, N, 4) | roll, pitch, yaw rate, thrust in [-1, 1] |
| ("agents", "observation", GROUP) | (E, N, ...) | the groups and masks of ``envs.observation`` |
| ("agents", "reward") | (E, N, 1) | weights . reward vector; only if weights are given |
| ("agents", "reward_vector") | (E, N, 4) | formation, flight, obstacle, action |
| "done", "terminated", "truncated" | (E, 1) | shared by the team; truncated is the time limit |

Episodes come from a stream of scenarios drawn in blocks from the seed; a partial reset takes the next ones.
"""

from collections.abc import Sequence
from typing import TypeVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from envs.formation import FormationEnv
from envs.scenarios import sample, select
from envs.spec import Observation, Scenarios, State

Batch = TypeVar("Batch", Scenarios, State)


class TorchRLFormationEnv(EnvBase):
    """``episodes`` flights of ``env`` side by side.

    ``weights`` (formation, flight, obstacle, action) add the scalar reward; ``hits`` end episodes, as in training.
    ``block`` scenarios are drawn at once, at least one for every episode. Works on either physics.
    """

    def __init__(
        self,
        env: FormationEnv,
        episodes: int,
        seed: int = 0,
        weights: Sequence[float] | None = None,
        hits: bool = True,
        block: int = 1024,
    ) -> None:
        super().__init__(device=env.device, batch_size=torch.Size([episodes]))
        self.env, self.hits = env, hits
        self.weights = None if weights is None else torch.tensor(tuple(weights), dtype=env.dtype, device=env.device)
        self.block = max(block, episodes)
        self.group_map = {"agents": [f"drone_{i}" for i in range(env.drones)]}
        self._pool: Scenarios | None = None
        self._next, self._used = seed, 0
        self._scenarios = self._draw(episodes)
        self._state = env.reset(self._scenarios)
        self._declare(env.observe(self._state, self._scenarios))
        self._set_seed(seed)  # the first reset starts the stream

    def _declare(self, observation: Observation) -> None:
        """Specifications of everything that goes in and out, from one observation."""
        team, drones = self.batch_size, torch.Size([*self.batch_size, self.env.drones])
        kind = {"dtype": self.env.dtype, "device": self.device}
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
        never = torch.zeros(self.batch_size, dtype=torch.bool, device=self.device)
        ended = (~never if mask is None else mask.flatten()).nonzero()[:, 0]
        fresh = self._draw(len(ended))
        self._scenarios = _put(self._scenarios, ended, fresh)
        self._state = _put(self._state, ended, self.env.reset(fresh))
        return self._output({}, self._flags(never, never))

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = tensordict["agents", "action"]
        self._state, vector, events = self.env.step(self._state, action, self._scenarios)
        rewards = {"reward_vector": vector}
        if self.weights is not None:
            rewards["reward"] = (vector * self.weights).sum(-1, keepdim=True)
        terminated = self.env.terminated(self._state, events, self.hits)
        return self._output(rewards, self._flags(terminated, self.env.truncated(self._state)))

    def _output(self, rewards: dict[str, Tensor], flags: dict[str, Tensor]) -> TensorDict:
        drones = [*self.batch_size, self.env.drones]
        seen = TensorDict(dict(self.env.observe(self._state, self._scenarios)), drones, self.device)
        agents = TensorDict({"observation": seen, **rewards}, drones, self.device)
        return TensorDict({"agents": agents, **flags}, self.batch_size, self.device)

    def _flags(self, terminated: Tensor, truncated: Tensor) -> dict[str, Tensor]:
        terminated, truncated = terminated[:, None], truncated[:, None]
        return {"done": terminated | truncated, "terminated": terminated, "truncated": truncated}

    def _draw(self, count: int) -> Scenarios:
        """The next ``count`` scenarios of the stream."""
        if self._used + count > self.block or self._pool is None:
            self._pool = sample(
                self.env.world.scenario, self.block, self._next, dtype=self.env.dtype, device=self.env.device
            )
            self._next, self._used = self._next + 1, 0
        self._used += count
        return select(self._pool, slice(self._used - count, self._used))

    def _set_seed(self, seed: int | None) -> None:
        """Start the stream of scenarios anew."""
        self._next, self._used = (0 if seed is None else seed), 0
        self._pool = None


def _put(batch: Batch, index: Tensor, rows: Batch) -> Batch:
    """``batch`` with the episodes at ``index`` (k,) replaced by the k of ``rows``."""
    fields = (old.index_copy(0, index, new) for old, new in zip(batch, rows, strict=True))
    return type(batch)(*fields)
