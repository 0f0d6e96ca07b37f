"""Where learners fly: a batch of episodes that restart by themselves from a pool of fresh scenarios."""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from algos.compilation import Compiler
from algos.statistics import KEYS, WIDTH, EpisodeStatistics, finished_sums, tally_step
from envs import memory
from envs import scenarios as drawing
from envs.formation import FormationEnv, where
from envs.spec import Events, Observation, Scenarios, ScenarioSpec, State

NEVER = 2**62
"""Step limit of episodes that only the scenario's own duration ends."""


class Outcome(NamedTuple):
    """What a step gave; episodes that ended have already been replaced by fresh ones."""

    reward: Tensor  # (E, N, 4) formation, flight, obstacle, action
    terminated: Tensor  # (E,) bool, crash or (if they count) hit: nothing follows
    truncated: Tensor  # (E,) bool, time is up
    hit: Tensor  # (E,) bool, a collision, whether or not it ends the episode


class Books(NamedTuple):
    """What an arena keeps beside the states of its episodes."""

    tally: Tensor  # (E, WIDTH) of the episodes under way, see `algos.statistics`
    limit: Tensor  # (E,) step at which an episode is cut, NEVER for all but staggered first ones
    cursor: Tensor  # () next scenario of the pool
    sums: Tensor  # (1 + len(KEYS),) of the episodes finished since the last update


class Arena:
    """E episodes advancing together. All randomness comes with the scenarios of the pool, so steps are reproducible.

    The pool is drawn in blocks because drawing a scenario costs more than flying a step; ended episodes take the next
    ones of the pool in turn.
    """

    def __init__(
        self,
        env: FormationEnv,
        drawn: ScenarioSpec,
        room: tuple[int, int],
        count: int,
        pool: int,
        seed: int,
        hits: bool,
        stagger: bool,
        compiler: Compiler,
    ) -> None:
        """`drawn` is the law of the episodes, `room` the columns and balls they are padded to, `count` E.

        `hits`: collisions end episodes, not only crashes. `stagger`: the first episodes end at random times (as time
        limits), or else all that survive would end together and every batch would show one phase of the flight.
        """
        self.env, self.room = env.compiled(compiler), room
        self.count, self.size, self.hits = count, pool, hits
        self.statistics = EpisodeStatistics(window=500, horizon=2 * round(drawn.duration / env.dt))
        self.flown = 0
        self.settle = compiler(self._settle)
        self.refresh(drawn, seed)
        every = torch.arange(count, device=env.device) % pool
        self.scenarios = drawing.select(self.pool, every)
        self.state = State(*(memory.ordered(field[every]) for field in self.starts))  # as every later one
        limit = torch.full((count,), NEVER)
        if stagger:
            generator = torch.Generator().manual_seed(seed)
            limit = torch.randint(1, round(drawn.duration / env.dt) + 1, (count,), generator=generator)
        self.books = Books(
            tally=torch.zeros((count, WIDTH), dtype=env.dtype, device=env.device),
            limit=limit.to(env.device),
            cursor=torch.tensor(count % pool, device=env.device),
            sums=torch.zeros(1 + len(KEYS), dtype=torch.float64, device=env.device),
        )
        self.ended = (self.state, self.scenarios)

    def refresh(self, drawn: ScenarioSpec, seed: int) -> None:
        """Draw a new pool from the law `drawn`; episodes under way are not touched."""
        self.drawn = drawn
        fresh = drawing.sample(drawn, self.size, seed, self.env.dtype, self.env.device)
        self.pool = drawing.pad(fresh, columns=self.room[0], balls=self.room[1])
        self.starts = self.env.reset(self.pool)

    def observe(self) -> Observation:
        """What the drones see now."""
        return self.env.observe(self.state, self.scenarios)

    def step(self, action: Tensor) -> Outcome:
        """Fly the commands (E, N, 4) in [-1, 1] for one control period and replace the episodes that end."""
        state, reward, events = self.env.step(self.state, action, self.scenarios)
        self.ended = (state, self.scenarios)
        self.flown += 1
        outcome, self.state, self.scenarios, self.books = self.settle(
            state, self.scenarios, reward, events, self.books, self.pool, self.starts
        )
        return outcome

    def final_observation(self) -> Observation:
        """What the drones saw at the end of the last step, before any episode was replaced."""
        return self.env.observe(*self.ended)

    def differentiate(self) -> None:
        """Let gradients flow back to the states as they are: the first step compiles as all later ones do."""
        self.state = State(*(field.requires_grad_(field.is_floating_point()) for field in self.state))

    def detach(self) -> None:
        """Forget how the current states came about: later gradients stop here."""
        self.state = State(*(field.detach() for field in self.state))
        self.ended = (self.state, self.scenarios)

    def metrics(self, total: Callable[[Tensor], Tensor] = lambda sums: sums) -> dict[str, float]:
        """Close an update: statistics of recently finished episodes; `total` adds those of other processes."""
        self.statistics.add(self.flown, total(self.books.sums))
        self.flown, self.books = 0, self.books._replace(sums=torch.zeros_like(self.books.sums))
        return self.statistics.metrics()

    def _settle(
        self,
        state: State,
        scenarios: Scenarios,
        reward: Tensor,
        events: Events,
        books: Books,
        pool: Scenarios,
        starts: State,
    ) -> tuple[Outcome, State, Scenarios, Books]:
        """Which episodes ended, what they come to, and the masked choice between going on and the pool's next one."""
        terminated = self.env.terminated(state, events, self.hits)
        truncated = (self.env.truncated(state) | (state.step >= books.limit)) & ~terminated
        done = terminated | truncated
        tally = tally_step(self.env, books.tally, state, reward, events)
        sums = books.sums + finished_sums(self.env, tally, state, done & (books.limit == NEVER))
        turn = done.long().cumsum(0)
        index = (books.cursor + turn - 1) % self.size
        state = where(done, State(*(field[index] for field in starts)), state)
        scenarios = where(done, drawing.select(pool, index), scenarios)
        books = Books(
            tally=torch.where(done[:, None], 0.0, tally),
            limit=torch.where(done, NEVER, books.limit),
            cursor=(books.cursor + turn[-1]) % self.size,
            sums=sums,
        )
        return Outcome(reward, terminated, truncated, self.env.hit(events)), state, scenarios, books

    def state_dict(self) -> dict[str, Any]:
        """Everything but the pool, which its seed restores."""
        return {
            "state": self.state._asdict(),
            "scenarios": self.scenarios._asdict(),
            "books": self.books._asdict(),
            "flown": self.flown,
            "statistics": self.statistics.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        device = self.env.device
        self.state = State(**{name: field.to(device) for name, field in state["state"].items()})
        self.scenarios = Scenarios(**{name: field.to(device) for name, field in state["scenarios"].items()})
        self.books = Books(**{name: field.to(device) for name, field in state["books"].items()})
        self.flown = state["flown"]
        self.statistics.load_state_dict(state["statistics"])
