"""Replay of collisions (Huang et al. 2023, Sec. III-D): episodes begin again shortly before somebody was hit.

The states of all episodes are kept every half second, for three seconds. When an episode meets something, the state of
1 to 1.5 s before goes into a store; where an episode ends, the next one is mostly one of those. All of an episode's
randomness lies in its scenario, so a state and its scenario are a whole snapshot.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from algos.arena import NEVER, Arena, Outcome
from envs.spec import Observation, Scenarios, State

BACK = 3
"""A hit is replayed from the last checkpoint but two: more than two periods before it."""


@dataclass(frozen=True)
class ReplaySpec:
    """When and how often collisions are flown again (`replay` in `conf/algo/swarm_rl.yaml`)."""

    share: float  # of the episodes that begin with one, once there are any; 0: none
    capacity: int  # snapshots stored; the oldest makes room
    period: float  # s, between two checkpoints
    start: float  # s, hits before are not stored
    pause: float  # s, between two stored hits of an episode
    uses: int  # replays after which a snapshot retires
    episodes: int  # finished ones before there is any replay
    crashes: float  # most of them, as a share, that may have ended on the floor or ceiling


class Snapshot(NamedTuple):
    """States and scenarios of K episodes."""

    state: State
    scenarios: Scenarios

    def pick(self, rows: Tensor) -> "Snapshot":
        """The episodes at `rows`, copied."""
        return Snapshot(*(type(part)(*(field[rows] for field in part)) for part in self))

    def put(self, rows: Tensor, other: "Snapshot") -> "Snapshot":
        """A copy in which those of `other` stand at `rows`."""
        return Snapshot(
            *(
                type(mine)(*map(_placed, mine, theirs, [rows] * len(mine)))
                for mine, theirs in zip(self, other, strict=True)
            )
        )


def _placed(field: Tensor, values: Tensor, rows: Tensor) -> Tensor:
    field = field.clone()
    field[rows] = values
    return field


class Replay:
    """The store and the rule by which it fills; `after` is to be called with every step of one arena."""

    def __init__(self, spec: ReplaySpec, dt: float, seed: int) -> None:
        self.spec, self.dt = spec, dt
        self.every = max(1, round(spec.period / dt))
        self.generator = torch.Generator().manual_seed(seed)
        self.active, self.ended, self.crashed = False, 0, 0
        self.store: Snapshot | None = None
        self.left = torch.zeros(0, dtype=torch.int64)  # replays left of each stored snapshot
        self.begin()

    def begin(self) -> None:
        """Forget the episodes under way, as in a new arena; what is stored stays."""
        self.clock = 0
        self.history: deque[tuple[int, Snapshot]] = deque(maxlen=BACK)
        self.born = self.stored = self.replayed = torch.zeros(0)

    def after(self, arena: Arena, outcome: Outcome) -> None:
        """Take note of a step of `arena`, and let some of the episodes that it has just begun be replays."""
        if not len(self.born):
            self.born = torch.zeros(arena.count, dtype=torch.int64)
            self.stored = torch.full((arena.count,), -NEVER)
            self.replayed = torch.zeros(arena.count, dtype=torch.bool)
        self.clock += 1
        self._keep(outcome.hit.cpu())
        done = (outcome.terminated | outcome.truncated).cpu()
        if done.any():
            self._judge(int(done.sum()), int(outcome.terminated.sum()))
            self.born[done], self.stored[done], self.replayed[done] = self.clock, -NEVER, False
            self._again(arena, done.nonzero().squeeze(-1))
        if self.clock % self.every == 0:
            everyone = torch.arange(arena.count, device=outcome.hit.device)
            self.history.append((self.clock, Snapshot(arena.state, arena.scenarios).pick(everyone)))

    def _keep(self, hit: Tensor) -> None:
        """Store where the episodes that were `hit` (E,) came from, if that is known and not yet stored."""
        if len(self.history) < BACK:
            return
        when, snapshot = self.history[0]
        old = (self.clock - self.born) * self.dt > self.spec.start
        rested = (self.clock - self.stored) * self.dt > self.spec.pause
        rows = (hit & old & rested & ~self.replayed & (self.born <= when)).nonzero().squeeze(-1)
        if self.active and len(rows):
            self.stored[rows] = self.clock
            self._add(snapshot.pick(rows.to(snapshot.state.position.device)))

    def _add(self, fresh: Snapshot) -> None:
        joined = fresh if self.store is None else _joined(self.store, fresh)
        last = slice(-self.spec.capacity, None)
        self.store = Snapshot(*(type(part)(*(field[last] for field in part)) for part in joined))
        self.left = torch.cat((self.left, torch.full((len(fresh.state.step),), self.spec.uses)))[last]

    def _judge(self, ended: int, crashed: int) -> None:
        """Whether drones fly well enough for replays to teach anything; once they do, it stays so."""
        self.ended, self.crashed = self.ended + ended, self.crashed + crashed
        if self.ended >= self.spec.episodes:
            self.active = self.active or self.crashed < self.spec.crashes * self.ended
            self.ended = self.crashed = 0

    def _again(self, arena: Arena, rows: Tensor) -> None:
        """Begin `share` of the episodes at `rows` from the store; they do not count in the arena's statistics."""
        if self.store is None or not len(self.left):
            return
        chosen = rows[torch.rand(len(rows), generator=self.generator) < self.spec.share]
        if not len(chosen):
            return
        entries = torch.randint(len(self.left), (len(chosen),), generator=self.generator)
        places = chosen.to(arena.env.device)
        now = Snapshot(arena.state, arena.scenarios).put(places, self.store.pick(entries.to(arena.env.device)))
        arena.state, arena.scenarios = now
        arena.books = arena.books._replace(limit=_placed(arena.books.limit, torch.tensor(NEVER - 1), places))
        self.replayed[chosen] = True
        self.left.index_add_(0, entries, torch.full_like(entries, -1))
        fresh = (self.left > 0).nonzero().squeeze(-1)
        if len(fresh) < len(self.left):
            self.store, self.left = self.store.pick(fresh.to(arena.env.device)), self.left[fresh]

    def state_dict(self) -> dict[str, Any]:
        """Everything that the next step depends on."""
        return {
            "flags": [self.clock, self.active, self.ended, self.crashed],
            "episodes": [self.born, self.stored, self.replayed],
            "history": [(clock, _plain(snapshot)) for clock, snapshot in self.history],
            "store": None if self.store is None else _plain(self.store),
            "left": self.left,
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a `state_dict`."""
        self.clock, self.active, self.ended, self.crashed = state["flags"]
        self.born, self.stored, self.replayed = (x.clone() for x in state["episodes"])
        self.history = deque(((clock, _read(plain)) for clock, plain in state["history"]), maxlen=BACK)
        self.store = None if state["store"] is None else _read(state["store"])
        self.left = state["left"].clone()
        self.generator.set_state(state["generator"])


class Replaying:
    """An arena whose ended episodes may go on from the store; what learners use of an arena."""

    def __init__(self, arena: Arena, replay: Replay) -> None:
        self.arena, self.replay = arena, replay

    def observe(self) -> Observation:
        """What the drones see now."""
        return self.arena.observe()

    def final_observation(self) -> Observation:
        """What the drones saw at the end of the last step, before any episode was replaced."""
        return self.arena.final_observation()

    def step(self, action: Tensor) -> Outcome:
        """Fly the commands for one control period and replace the episodes that end."""
        outcome = self.arena.step(action)
        self.replay.after(self.arena, outcome)
        return outcome


def _joined(one: Snapshot, other: Snapshot) -> Snapshot:
    return Snapshot(
        *(type(left)(*map(torch.cat, zip(left, right, strict=True))) for left, right in zip(one, other, strict=True))
    )


def _plain(snapshot: Snapshot) -> dict[str, Any]:
    return {"state": snapshot.state._asdict(), "scenarios": snapshot.scenarios._asdict()}


def _read(plain: dict[str, Any]) -> Snapshot:
    return Snapshot(State(**plain["state"]), Scenarios(**plain["scenarios"]))
