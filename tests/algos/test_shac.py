"""SHAC: the gradient through the world, where values are added, the target network, resuming, diverging."""

import copy
import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
import torch._inductor.config
from torch import Tensor

from algos import checkpoint
from algos.arena import NEVER, Arena
from algos.compilation import Compiler
from algos.learner import TrainingDiverged
from algos.mappo import utility
from algos.shac import Shac
from algos.trainer import Trainer, TrainSettings
from envs.formation import FormationEnv
from tests.algos.conftest import run, shac, train_settings, world

GAMMA = 0.99


def settings(updates: int = 2, **algo: Any) -> TrainSettings:
    """A training of 4 episodes, 6 steps at a time, on the smooth reward; episodes begin together."""
    spec = shac(**{"stagger": False, **algo})
    steps = updates * spec.envs * spec.rollout
    return replace(train_settings(), world=world(reward="smooth"), algo=spec, steps=steps)


def built(**algo: Any) -> tuple[Shac, Arena]:
    """A learner and its arena, in float64, with a critic that is not flat."""
    chosen = settings(**algo)
    learner = Trainer(chosen).learner
    for network in (learner.fast, learner.networks):
        network.double()
    torch.nn.init.normal_(learner.networks.value.weight, std=0.1)
    scenario, env = chosen.world.scenario, FormationEnv(chosen.world, torch.float64)
    room = (scenario.columns, scenario.balls)
    return learner, Arena(env, scenario, room, chosen.algo.envs, 8, 0, False, False, Compiler(False))


def limits(arena: Arena, *steps: int) -> None:
    arena.books = arena.books._replace(limit=torch.tensor(steps))


def climbed(learner: Shac, arena: Arena) -> tuple[float, dict[str, Tensor]]:
    """Loss and raw gradient of one roll-out from a copy of the arena, nothing being changed."""
    found: dict[str, Any] = {}

    def keep(loss: Tensor) -> dict[str, float]:
        learner.fast.policy.zero_grad()
        if loss.requires_grad:
            loss.backward()
        found["loss"] = loss.item()
        found["gradient"] = {n: copy.deepcopy(p.grad) for n, p in learner.fast.policy.named_parameters()}
        return {}

    generator = learner.generator.get_state()
    learner._climb = keep  # type: ignore[method-assign]
    learner._improve(copy.copy(arena))
    learner.generator.set_state(generator)
    del learner._climb
    return found["loss"], found["gradient"]


def test_every_piece_compiles_for_one_case_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """First step or later one, before or after a time limit or a new pool: compiling takes minutes, once is enough."""
    monkeypatch.setattr(torch, "compile", partial(torch.compile, backend="eager"))
    trainer = Trainer(replace(settings(updates=3, pool_updates=2), compile=True))
    limits(trainer.arena, 9, 3, NEVER, 5)
    with torch._dynamo.config.patch(error_on_recompile=True):
        run(trainer)
    assert trainer.compiler.enabled


def test_the_gradient_is_that_of_finite_differences() -> None:
    """Smooth parts, float64, 1e-5 relative: through networks, dynamics, reward, a time limit and the value."""
    learner, arena = built()
    limits(arena, NEVER, 3, NEVER, NEVER)
    _, gradient = climbed(learner, arena)
    step = 1e-6
    generator = torch.Generator().manual_seed(1)
    for name, parameter in learner.fast.policy.named_parameters():
        if name not in ("head.weight", "log_std", "encoder.embed.self.0.weight"):
            continue
        direction = torch.randn(parameter.shape, generator=generator, dtype=torch.float64)
        sides = []
        for sign in (1, -1):
            with torch.no_grad():
                parameter.add_(direction, alpha=sign * step)
            sides.append(climbed(learner, arena)[0])
            with torch.no_grad():
                parameter.sub_(direction, alpha=sign * step)
        numeric = (sides[0] - sides[1]) / (2 * step)
        assert (gradient[name] * direction).sum().item() == pytest.approx(numeric, rel=1e-5), name


def by_hand(learner: Shac, arena: Arena, value: Callable[[dict[str, Tensor]], Tensor]) -> float:
    """The loss, episode by episode in plain Python, from the numbers of the same flight."""
    spec, arena = learner.spec, copy.copy(arena)
    generator = torch.Generator()
    generator.set_state(learner.generator.get_state())
    std = learner.fast.policy.log_std.exp()
    total, since = 0.0, [0] * spec.envs
    for _ in range(spec.rollout):
        mean = learner.fast.policy(arena.observe())
        noise = torch.randn(mean.shape, generator=generator)
        outcome = arena.step((mean + std * noise).tanh())
        reward = utility(outcome.reward, learner.weights)
        final = value(arena.final_observation())
        for e in range(spec.envs):
            total += GAMMA ** since[e] * reward[e].sum().item()
            since[e] += 1
            if outcome.truncated[e]:
                total += GAMMA ** since[e] * final[e].sum().item()
            if outcome.terminated[e] or outcome.truncated[e]:
                since[e] = 0
    last = value(arena.observe())
    total += sum(GAMMA ** since[e] * last[e].sum().item() for e in range(spec.envs) if since[e])
    return -total / (spec.rollout * spec.envs * 3)


@torch.no_grad()
def test_discount_starts_again_and_values_are_added_at_horizons_and_time_limits_only() -> None:
    learner, arena = built()
    falling = arena.state.position.clone()
    falling[2, :, 2] = 0.2001  # this team is on the ground after a few steps
    down = arena.state.velocity.clone()
    down[2, :, 2] = -0.1
    arena.state = arena.state._replace(position=falling, velocity=down)
    limits(arena, NEVER, 3, NEVER, 6)  # the last one ends with the horizon: its value is added once

    def value(observation: dict[str, Tensor]) -> Tensor:
        return learner.spec.return_scale * learner.networks.critic(observation)

    watched = copy.copy(arena)
    ends = [watched.step(torch.zeros(4, 3, 4, dtype=torch.float64)) for _ in range(6)]
    assert any(outcome.terminated[2] for outcome in ends) and ends[2].truncated[1] and ends[5].truncated[3]
    assert climbed(learner, arena)[0] == pytest.approx(by_hand(learner, arena, value), rel=1e-6)


@torch.no_grad()
def test_the_critic_learns_nothing_beyond_a_crash_and_the_value_beyond_a_time_limit() -> None:
    learner, arena = built()
    limits(arena, NEVER, 2, NEVER, NEVER)
    learner._climb = lambda loss: {}  # type: ignore[method-assign]
    flown, _ = learner._improve(arena)
    assert flown.truncated.nonzero().tolist() == [[1, 1]]
    assert not torch.equal(flown.next_value[1, 1], flown.value[2, 1])  # the fresh episode is another one
    assert torch.equal(flown.next_value[0], flown.value[1])
    assert flown.observation["self"].shape[:3] == (6, 4, 3) and not flown.reward.requires_grad


@pytest.mark.parametrize(("updates", "policy_rate"), [(0, 5 / 6), (44, 0.1), (1000, 0.03)])
def test_the_slow_networks_follow_a_young_policy_closely(updates: int, policy_rate: float) -> None:
    learner, _ = built(policy_rate=0.03)
    learner.updates = updates
    torch.nn.init.normal_(learner.fast.policy.head.bias)
    slow, fast = copy.deepcopy(learner.networks), learner.fast
    learner._follow()
    for part, rate in ((0, policy_rate), (1, learner.spec.target_rate)):
        for before, after, goal in zip(*(x.parts()[part] for x in (slow, learner.networks, fast)), strict=True):
            torch.testing.assert_close(after, before + rate * (goal - before))
    assert not any(p.requires_grad for p in learner.networks.parameters())
    assert learner.policy is learner.networks.policy


def test_the_noise_stays_in_its_range() -> None:
    learner, _ = built(log_std=-0.7, log_std_range=(-0.71, -0.69), actor_learning_rate=1.0)
    for sign, bound in ((1, -0.71), (-1, -0.69)):
        learner._climb(sign * learner.fast.policy.log_std.sum())
        torch.testing.assert_close(learner.fast.policy.log_std.data, torch.full((4,), bound, dtype=torch.float64))


def test_resuming_equals_training_straight_through(tmp_path: Path) -> None:
    """Tensor for tensor, across a new pool."""
    chosen = settings(updates=4, stagger=True)
    straight, first, second = Trainer(chosen), Trainer(chosen), Trainer(chosen)
    run(straight), run(first, 1)
    checkpoint.save(tmp_path / "latest.pt", first.state_dict())
    second.load_state_dict(checkpoint.load(tmp_path / "latest.pt"))
    run(second)
    for key in ("learner", "arena", "steps"):
        assert checkpoint.digest(straight.state_dict()[key]) == checkpoint.digest(second.state_dict()[key]), key


def test_a_gradient_that_is_not_finite_stops_before_anything_has_changed(tmp_path: Path) -> None:
    trainer = Trainer(settings(updates=3))
    run(trainer, 1)
    checkpoint.save(tmp_path / "latest.pt", trainer.state_dict())
    before = checkpoint.digest(trainer.learner.state_dict())
    trainer.learner.fast.policy.head.weight.register_hook(lambda gradient: gradient * float("nan"))
    with pytest.raises(TrainingDiverged, match="steps=24, period=mixed") as error:
        run(trainer)
    assert error.value.record["policy/gradient"] != error.value.record["policy/gradient"]  # NaN
    assert checkpoint.digest(trainer.learner.state_dict()) == before
    assert checkpoint.digest(checkpoint.load(tmp_path / "latest.pt")["learner"]) == before


def test_a_critic_that_diverges_takes_the_actors_step_back() -> None:
    trainer = Trainer(settings(updates=3))
    run(trainer, 1)
    before = checkpoint.digest(trainer.learner.state_dict())
    trainer.learner.critic_loss = lambda *_: trainer.learner.fast.value.bias.sum() * float("nan")
    with pytest.raises(TrainingDiverged, match="loss/critic"):
        run(trainer)
    assert checkpoint.digest(trainer.learner.state_dict()) == before


def test_without_a_compiler_it_learns_all_the_same(caplog: pytest.LogCaptureFixture) -> None:
    with torch._inductor.config.patch({"cpp.cxx": ("/nowhere/g++",)}), caplog.at_level(logging.WARNING):
        (done,) = run(Trainer(replace(settings(updates=1), compile=True)))
    assert len(caplog.records) == 1 and "no C++ compiler found" in caplog.text
    assert {"loss/actor", "loss/critic", "policy/gradient", "policy/std", "learn/reward"} <= done.metrics.keys()


def test_settings_that_contradict_each_other() -> None:
    with pytest.raises(ValueError, match=r"algo.rollout = 24 does not divide into algo.critic_minibatches=5"):
        shac(critic_minibatches=5)
