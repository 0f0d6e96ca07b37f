"""The trainer: resuming bit for bit, periods, divergence, restarting episodes, compiling or not."""

import logging
import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import torch._inductor.config

from algos import checkpoint
from algos.arena import NEVER, Arena
from algos.compilation import Compiler
from algos.curriculum import CurriculumSpec, Period
from algos.learner import TrainingDiverged
from algos.mappo import utility
from algos.statistics import KEYS, EpisodeStatistics
from algos.trainer import Trainer, TrainSettings
from envs import scenarios
from envs.formation import FormationEnv
from tests.algos.conftest import encoder_spec, run, spec, train_settings

TWO = CurriculumSpec(
    "two",
    (Period("free", 1, {"columns": 0, "balls": 0}, "previous"), Period("mixed", 1, {}, "previous")),
)


def same(one: Any, other: Any) -> bool:
    return checkpoint.digest(one) == checkpoint.digest(other)


@pytest.mark.parametrize("stop", [1, 2, 3, 5])
@pytest.mark.parametrize("changes", [{}, {"share_encoder": True, "fresh_optimiser": False}])
def test_resuming_equals_training_straight_through(tmp_path: Path, stop: int, changes: dict[str, Any]) -> None:
    """Tensor for tensor: the stop falls before, at and after a change of period and of the scenario pool."""
    settings = replace(train_settings(updates=6, **changes), curriculum=TWO)
    straight = Trainer(settings)
    expected = run(straight)
    first = Trainer(settings)
    run(first, stop)
    checkpoint.save(tmp_path / "latest.pt", first.state_dict())
    random.seed(1), np.random.seed(1), torch.manual_seed(1)
    second = Trainer(settings)
    second.load_state_dict(checkpoint.load(tmp_path / "latest.pt"))
    resumed = run(second)
    assert [p.period for p in expected] == ["free"] * 3 + ["mixed"] * 3
    for one, other in zip(expected[stop:], resumed, strict=True):
        ours, theirs = dict(one.metrics), dict(other.metrics)
        del ours["steps_per_second"], theirs["steps_per_second"]
        assert (one.steps, one.period, ours) == (other.steps, other.period, theirs)
    ours, theirs = straight.state_dict(), second.state_dict()
    for key in ("steps", "plan", "stage", "drawn", "learner", "arena"):
        assert same(ours[key], theirs[key]), key
    assert same(straight.arena.pool._asdict(), second.arena.pool._asdict())


def test_state_holds_the_generators_of_python_numpy_and_torch() -> None:
    trainer = Trainer(train_settings())
    state = trainer.state_dict()
    expected = random.random(), np.random.rand(), torch.rand(()).item()
    trainer.load_state_dict(state)
    assert (random.random(), np.random.rand(), torch.rand(()).item()) == expected


def test_seeds_decide_everything() -> None:
    one, other, third = (Trainer(train_settings(seed=seed, updates=1)) for seed in (3, 3, 4))
    run(one), run(other), run(third)
    assert same(one.learner.state_dict(), other.learner.state_dict())
    assert not same(dict(one.policy.state_dict()), dict(third.policy.state_dict()))
    assert not torch.equal(one.arena.scenarios.columns, third.arena.scenarios.columns)


def test_a_checkpoint_of_other_settings_is_refused() -> None:
    state = Trainer(train_settings()).state_dict()
    with pytest.raises(ValueError, match=r"another training: algo\.gamma was 0\.99, now it is 0\.9"):
        Trainer(train_settings(gamma=0.9)).load_state_dict(state)
    with pytest.raises(ValueError, match=r"encoder\.\w+ was"):
        Trainer(replace(train_settings(), encoder=encoder_spec("no_sa"))).load_state_dict(state)


def test_periods_pad_to_one_shape_and_share_one_world() -> None:
    trainer = Trainer(replace(train_settings(updates=4), curriculum=TWO))
    assert trainer.arena.scenarios.columns.shape == (8, 10, 2)
    assert trainer.arena.scenarios.throw_time.isinf().all()
    run(trainer)
    assert trainer.arena.scenarios.columns.abs().max() < 100
    assert len(trainer.worlds) == 1 and trainer.arena.drawn.balls == 2


def test_scratch_starts_from_fresh_weights_and_previous_goes_on() -> None:
    for start, kept in (("previous", True), ("scratch", False)):
        periods = (replace(TWO.periods[0]), replace(TWO.periods[1], start=start))
        settings = replace(
            train_settings(updates=2, actor_learning_rate=0.0, critic_learning_rate=0.0),
            curriculum=CurriculumSpec("two", periods),
        )
        trainer = Trainer(settings)
        before = {name: x.clone() for name, x in trainer.policy.state_dict().items()}
        run(trainer)
        assert same(before, dict(trainer.policy.state_dict())) == kept


def test_learning_rates_fall_linearly_within_a_period() -> None:
    trainer = Trainer(train_settings(updates=4, final_learning_rate=0.2))
    rates = []
    for _ in trainer.train():
        rates.append([optimiser.param_groups[0]["lr"] for optimiser in trainer.learner.optimisers])
    actor, critic = zip(*rates, strict=True)
    assert actor == critic == pytest.approx([1.5e-3 * share for share in (1.0, 0.8, 0.6, 0.4)])


def test_divergence_keeps_the_last_good_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = Trainer(train_settings(updates=4))
    run(trainer, 1)
    good = trainer.learner.state_dict()
    before = checkpoint.digest(good)
    losses, calls = trainer.learner.losses, []

    def broken(batch: Any) -> Any:
        calls.append(1)
        policy, *rest = losses(batch)
        return policy * (float("nan") if len(calls) == 3 else 1.0), *rest

    monkeypatch.setattr(trainer.learner, "losses", broken)
    with pytest.raises(TrainingDiverged, match="training diverged: steps=32, period=mixed") as error:
        run(trainer)
    record = error.value.record
    assert record["minibatch"] == 2 and np.isnan(record["loss/policy"]) and np.isfinite(record["loss/value"])
    assert "policy.head.weight" in record["non_finite_gradients"]
    assert checkpoint.digest(trainer.learner.state_dict()) == before


@pytest.mark.parametrize("weights", [(0.5, 0.5, 0.5, 0.5), (1.2, -0.2, 0.0, 0.0), (1.0, 0.0, 0.0)])
def test_weights_have_to_be_on_the_simplex(weights: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="four numbers >= 0 that sum to 1"):
        Trainer(replace(train_settings(), weights=weights))


def test_utility_is_the_weighted_sum() -> None:
    reward = torch.tensor([[1.0, 10.0, 100.0, 1000.0]])
    assert utility(reward, (0.1, 0.2, 0.3, 0.4)).item() == pytest.approx(0.1 + 2 + 30 + 400)


def test_settings_that_contradict_each_other() -> None:
    with pytest.raises(ValueError, match=r"algo.envs \* algo.rollout = 32 does not divide into algo.minibatches=5"):
        train_settings(minibatches=5)
    with pytest.raises(ValueError, match=r"algo.stagger=true .*algo.bootstrap_time_limit=true"):
        train_settings(bootstrap_time_limit=False)


def arena(settings: TrainSettings, **changes: Any) -> Arena:
    env = FormationEnv(settings.world)
    scenario = settings.world.scenario
    given = {"count": 8, "pool": 16, "seed": 0, "hits": True, "stagger": False, "compiler": Compiler(False)}
    return Arena(env, scenario, (scenario.columns, scenario.balls), **(given | changes))


def test_ended_episodes_take_the_next_scenarios_of_the_pool_in_turn() -> None:
    flown = arena(train_settings())
    fall = torch.full((8, 3, 4), -1.0) * torch.tensor([0, 0, 0, 1.0])
    for _ in range(1000):
        before = flown.state.step.clone()
        outcome = flown.step(fall)
        if outcome.terminated.any():
            break
    assert outcome.terminated.all()  # everybody falls alike
    assert torch.equal(flown.scenarios.id, torch.arange(8, 16))
    expected = scenarios.select(flown.pool, torch.arange(8, 16))
    assert torch.equal(flown.scenarios.columns, expected.columns)
    assert torch.equal(flown.state.position, expected.position) and (flown.state.step == 0).all()
    ended, _ = flown.ended
    assert torch.equal(ended.step, before + 1) and (ended.position[..., 2] < 0.2).any()
    metrics = flown.metrics()
    assert metrics["train/episodes"] == 8 and metrics["train/fail_ground"] == 1
    assert metrics["train/collision_free"] == 0 and metrics["train/cfr"] == 0
    assert metrics["train/seconds"] == pytest.approx(int(ended.step[0]) * flown.env.dt)


def test_statistics_forget_by_number_and_by_age() -> None:
    statistics = EpisodeStatistics(window=10, horizon=100)

    def add(episodes: int, failed: int) -> float | None:
        sums = torch.zeros(1 + len(KEYS), dtype=torch.float64)
        sums[0], sums[1 + KEYS.index("fail_ground")] = episodes, failed
        statistics.add(32, sums)
        return statistics.metrics().get("train/fail_ground")

    assert add(0, 0) is None
    assert add(8, 8) == 1
    assert add(8, 0) == 0.5  # 8 alone are fewer than 10
    assert add(2, 0) == 0  # 8 + 2 are enough without the first
    assert [add(0, 0) for _ in range(3)] == [0, 0, 0]
    assert add(1, 1) == 1  # the others ended more than 100 steps ago


def test_staggered_starts_are_cut_once_and_not_counted() -> None:
    flown = arena(train_settings(), stagger=True, seed=5)
    limit = flown.books.limit.clone()
    assert ((limit >= 1) & (limit <= 900)).all() and limit.unique().numel() > 1
    flown.books = flown.books._replace(limit=torch.tensor([2, NEVER, 3, NEVER, NEVER, NEVER, NEVER, NEVER]))
    hover = torch.zeros(8, 3, 4)
    cut = [flown.step(hover).truncated.nonzero().flatten().tolist() for _ in range(4)]
    assert cut == [[], [0], [2], []]
    assert (flown.books.limit == NEVER).all()
    assert flown.metrics() == {}


def test_time_limits_are_worth_their_last_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """The value that follows a cut is the critic's of the state before the episode is replaced."""
    trainer = Trainer(train_settings())
    trainer.arena.books = trainer.arena.books._replace(limit=torch.tensor([1] + [NEVER] * 7))
    learner = trainer.learner
    rollout = learner._fly(trainer.arena)
    assert rollout.truncated.nonzero().tolist() == [[0, 0]]
    fresh, kept = rollout.value[1, 0], rollout.next_value[0, 0]
    assert not torch.equal(fresh, kept)
    assert torch.equal(rollout.next_value[0, 1:], rollout.value[1, 1:])
    again = Trainer(train_settings())
    again.arena.books = again.arena.books._replace(limit=torch.full((8,), NEVER))
    uncut = again.learner._fly(again.arena)
    torch.testing.assert_close(kept, uncut.next_value[0, 0])


def test_without_a_compiler_training_goes_on_with_one_notice(caplog: pytest.LogCaptureFixture) -> None:
    with torch._inductor.config.patch({"cpp.cxx": ("/nowhere/g++",)}), caplog.at_level(logging.WARNING):
        run(Trainer(replace(train_settings(updates=1), compile=True)))
    assert [record.getMessage() for record in caplog.records] == [
        "not compiled, which is several times slower: no C++ compiler found (apt install g++, or set CXX)"
    ]


def test_failed_compilation_falls_back_once(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    from torch._dynamo.exc import BackendCompilerFailed

    def refuse(function: Any, **_: Any) -> Any:
        def call(*_: Any) -> Any:
            raise BackendCompilerFailed(lambda: None, RuntimeError("no space left for code"), None)

        return call

    monkeypatch.setattr(torch, "compile", refuse)
    compiler = Compiler(True)
    double, triple = compiler(lambda x: 2 * x), compiler(lambda x: 3 * x)
    with caplog.at_level(logging.WARNING):
        assert (double(2), triple(2), double(3)) == (4, 6, 6)
    assert len(caplog.records) == 1 and "not compiled" in caplog.text and not compiler.enabled


def test_the_published_settings_are_those_of_the_release() -> None:
    from algos.mappo import MappoSpec

    published = spec(MappoSpec, "algo", "mappo")
    assert (published.envs, published.rollout, published.epochs, published.minibatches) == (1024, 64, 4, 16)
    assert (published.gamma, published.gae_decay, published.clip, published.huber_delta) == (0.995, 0.95, 0.1, 10)
    assert not published.bootstrap_time_limit and published.value_loss == "batch_means"
