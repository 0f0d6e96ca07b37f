"""Replay of collisions: what is stored, what comes back bit for bit, and that a training with it resumes."""

from dataclasses import replace

import pytest
import torch

from algos.arena import Arena, Outcome
from algos.compilation import Compiler
from algos.replay import Replay, ReplaySpec
from algos.trainer import Trainer, TrainSettings
from envs.formation import FormationEnv
from envs.spec import State
from formctl.settings import build, compose
from tests.algos.conftest import world

SPEC = ReplaySpec(
    share=1.0, capacity=8, period=0.1, start=0.3, pause=1.0, uses=2, episodes=1, crashes=0.5
)  # 5 steps of 20 ms between checkpoints


@pytest.fixture
def arena() -> Arena:
    env = FormationEnv(world("mixed", throw_time=(0.1, 0.5)))
    return Arena(env, env.world.scenario, (10, 2), 3, 16, 0, True, False, Compiler(False))


def outcome(*hit: int, ended: tuple[int, ...] = (), crashed: tuple[int, ...] = ()) -> Outcome:
    flags = [torch.tensor([k in chosen for k in range(3)]) for chosen in (crashed, ended, hit)]
    return Outcome(torch.zeros(3, 3, 4), *flags)


def fly(arena: Arena, replay: Replay, steps: int, hits: dict[int, Outcome] | None = None) -> list[State]:
    """Steps of the arena in which happens what `hits` says; the states that they led to."""
    found = []
    for step in range(steps):
        generator = torch.Generator().manual_seed(replay.clock)
        arena.step(0.1 * torch.randn((3, 3, 4), generator=generator))
        found.append(arena.state)
        replay.after(arena, (hits or {}).get(step, outcome()))
    return found


def test_a_snapshot_comes_back_bit_for_bit_and_flies_on_as_it_did(arena: Arena) -> None:
    replay = Replay(SPEC, arena.env.dt, 0)
    replay.active = True
    states = fly(arena, replay, 29, {27: outcome(1), 28: outcome(ended=(0,))})
    before, after = states[14], arena.state  # the third-last of the checkpoints after 15, 20 and 25 steps
    for was, now in zip(before, after, strict=True):
        assert torch.equal(was[1], now[0])
    assert not torch.equal(before.position[0], after.position[0])
    again = arena.state
    for step in range(15, 29):
        action = 0.1 * torch.randn((3, 3, 4), generator=torch.Generator().manual_seed(step))
        again = arena.env.step(again, action[[1, 1, 2]], arena.scenarios)[0]
        if step < 28:
            for was, now in zip(states[step], again, strict=True):
                assert torch.equal(was[1], now[0])
    assert arena.books.limit[0] < arena.books.limit[1], "a replay is not counted among the episodes"


def test_what_is_stored(arena: Arena) -> None:
    replay = Replay(SPEC, arena.env.dt, 0)
    fly(arena, replay, 30, {20: outcome(0)})
    assert replay.store is None, "inactive as long as nobody has flown an episode to its end"
    replay.active = True
    fly(arena, replay, 30, {0: outcome(0, 2), 1: outcome(0), 10: outcome(2)})
    assert replay.left.tolist() == [2, 2], "once per pause"
    fly(arena, replay, 30, {25: outcome(0, 1)})
    assert replay.left.tolist() == [2, 2, 2, 2], "again after the pause"
    fly(arena, replay, 20, {0: outcome(ended=(1,)), 14: outcome(1)})
    assert replay.left.sum() == 7, "an episode that began with a replay is not stored"
    fly(arena, replay, 40, {k: outcome(ended=(0, 1, 2)) for k in range(0, 40, 8)})
    assert len(replay.left) == 0 and replay.replayed.tolist() == [False] * 3, "all have retired"


def test_an_early_hit_or_one_of_an_unknown_past_is_not_stored(arena: Arena) -> None:
    replay = Replay(SPEC, arena.env.dt, 0)
    replay.active = True
    fly(arena, replay, 30, {3: outcome(0), 14: outcome(1)})
    assert replay.store is None
    replay.spec = replace(SPEC, start=0.1)
    fly(arena, replay, 20, {0: outcome(ended=(0,)), 10: outcome(0)})
    assert replay.store is None, "three checkpoints back it was another episode"


def test_replays_wait_until_few_episodes_crash(arena: Arena) -> None:
    replay = Replay(replace(SPEC, episodes=4), arena.env.dt, 0)
    fly(arena, replay, 2, {0: outcome(crashed=(0, 1)), 1: outcome(ended=(0, 1))})
    assert not replay.active
    fly(arena, replay, 2, {0: outcome(crashed=(0,), ended=(1, 2)), 1: outcome(ended=(0,))})
    assert replay.active


def settings() -> TrainSettings:
    small = ("envs=4", "rollout=30", "minibatches=4", "pool=8", "pool_updates=2", "replay.period=0.05")
    more = ("replay.start=0.1", "replay.pause=0.1", "replay.episodes=1", "replay.crashes=1.5", "annealing=0.5")
    config = compose(
        [
            "experiment=swarm_rl",
            "encoder=swarm_rl_small",
            "scenario.hit_radius=1.7",  # somebody is always hit
            "scenario.duration=0.8",
            *(f"algo.{word}" for word in (*small, *more)),
            "train.steps=1200",
            "train.compile=false",
        ]
    )
    return build.training(config)


def test_a_training_with_replays_resumes_bit_for_bit() -> None:
    whole = Trainer(settings())
    progress = list(whole.train())
    assert progress[-1].metrics["learn/snapshots"] > 0
    assert [round(p.metrics["learn/annealing"], 2) for p in progress[:6]] == [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]
    begun = Trainer(settings())
    updates = begun.train()
    for _ in range(7):
        next(updates)
    resumed = Trainer(settings())
    resumed.load_state_dict(begun.state_dict())
    rest = list(resumed.train())
    assert [p.steps for p in rest] == [p.steps for p in progress[7:]]
    for ours, theirs in zip(resumed.policy.parameters(), whole.policy.parameters(), strict=True):
        assert torch.equal(ours, theirs)
