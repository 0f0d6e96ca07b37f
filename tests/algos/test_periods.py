"""Periods that hand the policy to another learner, ramp their scenes or end early; all of it resumes bit for bit."""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from algos import checkpoint
from algos.arena import NEVER
from algos.curriculum import CurriculumSpec, Period
from algos.mappo import Mappo
from algos.shac import Shac
from algos.trainer import Trainer, TrainSettings
from tests.algos.conftest import curriculum_spec, mappo, reward_spec, run, shac, train_settings

FIRST = Period(
    "first",
    2,
    {},
    "previous",
    algo=shac(pool_updates=1),
    reward=reward_spec("smooth"),
    ramp={"columns": (2, 12), "balls": (0, 3)},
)
LAST = Period("last", 1, {}, "previous", algo=mappo(), reward=reward_spec("shaped"))


def settings(*periods: Period, steps: int) -> TrainSettings:
    return replace(train_settings(), curriculum=CurriculumSpec("test", periods), steps=steps)


def facts(done: list[Any]) -> list[Any]:
    return [(p.steps, p.total, p.period, {k: v for k, v in p.metrics.items() if k != "steps_per_second"}) for p in done]


def end_soon(trainer: Trainer) -> None:
    """Every episode reaches its full length in the next update, and is counted."""
    arena, envs = trainer.arena, trainer.stage.algo.envs
    arena.state = arena.state._replace(step=torch.full((envs,), 897))
    arena.books = arena.books._replace(limit=torch.full((envs,), NEVER))


def test_resuming_across_promotions_ramps_and_changes_of_learner(tmp_path: Path) -> None:
    """SHAC that ends early (24 steps an update), SHAC on a ramp, MAPPO (32): stopped after the first update, which
    ends the first period, and before the last one."""
    early = Period("early", 3, {}, "previous", algo=shac(), advance_when={"seconds": 0.0, "episodes": 1})
    chosen = settings(early, FIRST, LAST, steps=208)
    straight = Trainer(chosen)
    end_soon(straight)
    start = copy.deepcopy(straight.state_dict())
    expected = run(straight)
    for stop in (1, len(expected) - 1):
        first, second = Trainer(chosen), Trainer(chosen)
        first.load_state_dict(start)
        done = run(first, stop)
        checkpoint.save(tmp_path / "latest.pt", first.state_dict())
        second.load_state_dict(checkpoint.load(tmp_path / "latest.pt"))
        assert facts(done + run(second)) == facts(expected)
        ours, theirs = straight.state_dict(), second.state_dict()
        for key in ("steps", "plan", "stage", "drawn", "learner", "arena"):
            assert checkpoint.digest(ours[key]) == checkpoint.digest(theirs[key]), key
    assert [p.period for p in expected] == ["early", *["first"] * 4, *["last"] * 2]  # first: 3, had early taken its 4
    assert [p.metrics.get("period/advanced") for p in expected] == [1.0] + 6 * [None]
    assert [p.metrics.get("period/columns") for p in expected[1:5]] == [2, 5, 9, 12]
    assert isinstance(straight.learner, Mappo) and straight.arena.env.world.reward == LAST.reward
    assert straight.room == (12, 3)


def test_the_next_learner_takes_policy_noise_and_critic() -> None:
    chosen = settings(FIRST, LAST, steps=24 * 2 + 32)
    trainer = Trainer(chosen)
    run(trainer, 2)
    before = trainer.learner
    assert isinstance(before, Shac)
    with torch.no_grad():
        seen = trainer.arena.observe()
        mean, value = before.policy(seen), before.spec.return_scale * before.networks.critic(seen)
        trainer._enter()
        after = trainer.learner
        assert isinstance(after, Mappo) and not after.optimisers[0].state
        torch.testing.assert_close(after.policy(seen), mean)
        assert torch.equal(after.policy.log_std, before.policy.log_std)
        torch.testing.assert_close(after.value_norm.denormalise(after.networks.critic(seen)), value)
        back = trainer.settings.curriculum.periods[0].algo.build(trainer._problem(), 0, trainer.compiler)
        after.value_norm.adopt(5.0, 7.0)
        back.inherit(after)
        told = after.value_norm.denormalise(after.networks.critic(seen))
        torch.testing.assert_close(back.spec.return_scale * back.networks.critic(seen), told)


def test_a_shared_encoder_hands_on_the_policy_alone() -> None:
    trainer = Trainer(settings(FIRST, replace(LAST, algo=mappo(share_encoder=True)), steps=24 + 32))
    run(trainer, 1)
    before = checkpoint.digest(dict(trainer.policy.state_dict()))
    trainer._enter()
    assert checkpoint.digest(dict(trainer.policy.state_dict())) == before
    assert trainer.learner.value_scale() == (0.0, 1.0)


def test_the_shipped_example_changes_hands() -> None:
    trainer = Trainer(replace(train_settings(), curriculum=curriculum_spec("shac_then_mappo"), steps=24 * 2 + 32 * 2))
    assert [(p.period, p.metrics.keys() >= {"loss/actor"}) for p in run(trainer)] == [
        ("easy", True),
        ("differentiable", True),
        ("sampled", False),
        ("sampled", False),
    ]
    assert trainer.steps <= 24 * 2 + 32 * 2


def test_a_last_period_that_reaches_its_rule_ends_the_training() -> None:
    only = Period("only", 1, {}, "previous", advance_when={"episodes": 1})
    trainer = Trainer(settings(only, steps=320))
    end_soon(trainer)
    (done,) = run(trainer)
    assert (done.steps, done.total, done.metrics["period/advanced"]) == (32, 32, 1.0)
