"""What the interfaces share: an endless stream of episodes, and observations as one vector per drone.

The vector of a drone, with N drones and M balls (``envs.observation`` says what the numbers are):

| index | group | numbers | content with ``observation=paper`` | range |
|---|---|---|---|---|
| 0 to 2 | self | 3 | x in m, 0.2 (y - scheduled y) in m, z - commanded height in m | unbounded |
| 3 to 6 | self | 4 | attitude quaternion wxyz, body to world | [-1, 1] |
| 7 to 9 | self | 3 | 0.5 x velocity in m/s, world | unbounded |
| 10 to 12 | self | 3 | 0.1 x body rates in rad/s, body | unbounded |
| 13 to 18 | self | 6 | heading axis, up axis, world | [-1, 1] |
| 19 to 21 | self | 3 | v* - v in m/s, world | unbounded |
| 22 to 24 | self | 3 | own slot in the formation, in circumradii | [-1, 1] |
| 7 (N - 1) more | drones | 7 each | another drone: formation error, half the distance, v_i - v_j; m, s | unbounded |
| 9 more | static | 9 | 3 x 3 grid of distances to the nearest column, conditioned | unbounded |
| 10 M more | dynamic | 10 each | closest pass: time in s, squashed offset; 0.3 x velocities in m/s | unbounded |
| 1 more | static_mask | 1 | whether there is any column | 0 or 1 |
| M more | dynamic_mask | 1 each | whether the ball is in the air and seen | 0 or 1 |

Other observation settings change the groups' widths and scales, not their order.
"""

from typing import NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from envs import memory
from envs.formation import FormationEnv
from envs.scenarios import sample, select
from envs.spec import Events, Observation, Scenarios, State

Batch = TypeVar("Batch", Scenarios, State)

GROUPS = ("self", "drones", "static", "dynamic", "static_mask", "dynamic_mask")
"""Order of the groups in a drone's vector."""


class Transition(NamedTuple):
    """What one step of every episode gave."""

    reward: Tensor  # (E, N, 4) formation, flight, obstacle, action
    terminated: Tensor  # (E,) bool, a crash or (where they count) a hit
    truncated: Tensor  # (E,) bool, the episode's time is up
    events: Events


class EpisodeStream:
    """E episodes of ``env`` side by side; one that has ended goes on with the next scenario of the stream.

    Scenarios are drawn ``block`` at a time from ``seed``: the same calls after the same seed give the same episodes.
    ``hits_terminate``: collisions end episodes, as in training, not only crashes.
    """

    def __init__(
        self, env: FormationEnv, episodes: int, seed: int = 0, hits_terminate: bool = True, block: int = 1024
    ) -> None:
        self.env, self.episodes, self.hits_terminate = env, episodes, hits_terminate
        self.block = max(block, episodes)
        self.seed(seed)
        self.restart()
        self.seed(seed)  # the first restart of the caller begins the stream

    def seed(self, seed: int) -> None:
        """Begin the stream of scenarios anew; episodes under way are not touched."""
        self._seed, self._blocks, self._used = seed, 0, self.block

    def restart(self) -> None:
        """Every episode starts, each with the next scenario of the stream."""
        self.scenarios = self._draw(self.episodes)
        self.state = self.env.reset(self.scenarios)

    def replace(self, ended: Tensor) -> None:
        """The episodes where ``ended`` (E,) bool is set start with the next scenarios; the others go on."""
        index = ended.nonzero()[:, 0]
        if len(index):
            fresh = self._draw(len(index))
            self.scenarios = _put(self.scenarios, index, fresh)
            self.state = _put(self.state, index, self.env.reset(fresh))

    def observe(self) -> Observation:
        """What the drones see now."""
        return self.env.observe(self.state, self.scenarios)

    def step(self, action: Tensor) -> Transition:
        """Fly the commands (E, N, 4) in [-1, 1] for one control period; nothing is replaced."""
        self.state, reward, events = self.env.step(self.state, action, self.scenarios)
        terminated = self.env.terminated(self.state, events, self.hits_terminate)
        return Transition(reward, terminated, self.env.truncated(self.state) & ~terminated, events)

    def _draw(self, count: int) -> Scenarios:
        """The next ``count`` scenarios of the stream."""
        if self._used + count > self.block:
            block_seed = int(np.random.SeedSequence([self._seed, self._blocks]).generate_state(1)[0])
            drawn = self.env.world.scenario
            self._pool = sample(drawn, self.block, block_seed, dtype=self.env.dtype, device=self.env.device)
            self._blocks, self._used = self._blocks + 1, 0
        self._used += count
        return select(self._pool, slice(self._used - count, self._used))


def flatten(observation: Observation) -> Tensor:
    """One vector per drone, (E, N, d): the groups in the order of ``GROUPS``, masks as 0 and 1."""
    real = observation["self"]
    parts = [observation[name].to(real.dtype).flatten(2) for name in GROUPS]
    return torch.cat(parts, -1)


def _put(batch: Batch, index: Tensor, rows: Batch) -> Batch:
    """``batch`` with the episodes at ``index`` (k,) replaced by the k of ``rows``."""
    fields = (memory.ordered(old.index_copy(0, index, new)) for old, new in zip(batch, rows, strict=True))
    return type(batch)(*fields)
