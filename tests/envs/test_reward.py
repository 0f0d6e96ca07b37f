"""Reward vectors against values worked out by hand."""

import re
from dataclasses import replace

import pytest
import torch

from envs import scenarios
from envs.vocabulary import OBJECTIVES
from formctl.errors import ConfigError
from tests.envs.test_dynamics import command

FLIGHT = OBJECTIVES.index("flight")


def cruise(env, **changes):
    """One judged step of a perfect cruise at v*, with parts of the end state replaced."""
    drawn = scenarios.sample(env.world.scenario, 1, 0, dtype=env.dtype)
    state = env.reset(drawn)
    velocity = torch.tensor([0.0, 2.0, 0.0], dtype=env.dtype).expand_as(state.velocity)
    before = state._replace(velocity=velocity, step=state.step + 10)
    after = before._replace(position=before.position + env.dt * velocity, step=before.step + 1)
    after = after._replace(**{name: change(getattr(after, name)) for name, change in changes.items()})
    reward, events = env.judge(before, after, drawn)
    return reward[0], events


def unscaled(make_env, *words, reward="smooth", scenario="free"):
    """A world with the bare sums of a reward's terms."""
    scales = (f"reward.scale.{name}=1" for name in OBJECTIVES)
    return make_env(f"scenario={scenario}", f"reward={reward}", *scales, *words)


def test_release_reward_of_a_perfect_cruise_is_the_fact_sheets(make_env):
    reward, _ = cruise(unscaled(make_env, reward="release"))
    formation, flight, obstacle, action = reward[0].tolist()
    # Two balls that have not been thrown yet do not gate anything: c = 1.
    assert formation == pytest.approx(5 * 2 + 5 * 0.4312, abs=2e-3)  # 12.2
    assert flight == pytest.approx(26, abs=1e-3)
    assert obstacle == 0
    assert action == pytest.approx(2.5 + 1.5 + 2 * 0.5, abs=1e-3)


def test_release_failure_costs_every_objective_ten(make_env):
    env = unscaled(make_env, reward="release")
    fine, _ = cruise(env)
    crashed, _ = cruise(env, position=lambda p: p - torch.tensor([0, 0, 1.4], dtype=p.dtype))
    assert (fine - crashed)[0, OBJECTIVES.index("obstacle")].item() == pytest.approx(10)
    assert (fine - crashed)[0, OBJECTIVES.index("action")].item() == pytest.approx(10)


def test_release_ball_term_has_no_unbounded_positive_part(make_env):
    env = unscaled(make_env, "scenario.balls=1", reward="release", scenario="dynamic")

    def ball_at(distance):
        place = torch.tensor([[[1 + distance, 0.04, 1.5]]], dtype=env.dtype)
        reward, _ = cruise(
            env,
            ball_origin=lambda _: place,
            ball_velocity=lambda v: v,
            ball_time=lambda t: torch.zeros_like(t),
            ball_landing=lambda t: torch.ones_like(t) * 9,
        )
        return reward[0, OBJECTIVES.index("obstacle")].item()

    assert ball_at(5.0) == 0
    generous = "reward.obstacle.release_ball={weight: 10.0, slope: 25.0, hard: 0.4, soft: 0.6, far_cap: 1.0}"
    env = unscaled(make_env, "scenario.balls=1", generous, reward="release", scenario="dynamic")
    assert ball_at(5.0) == pytest.approx(10)


def test_paper_reward_of_a_perfect_cruise(make_env):
    reward, _ = cruise(unscaled(make_env, reward="paper"))
    formation, flight, obstacle, action = reward[0].tolist()
    assert formation == pytest.approx(2, abs=1e-5)
    # heading, velocity and height are perfect; after 0.22 s the slot at v* is 0.4 m ahead of a drone that stood still
    assert flight == pytest.approx(3 + 1 / (1 + 0.4), abs=1e-5)
    assert obstacle == pytest.approx(0, abs=1e-9)
    assert action == pytest.approx(4, abs=1e-5)


def test_shaped_reward_of_a_perfect_cruise_and_its_gradient_at_the_optimum(make_env):
    reward, _ = cruise(unscaled(make_env, reward="shaped"))
    formation, flight, obstacle, action = reward[0].tolist()
    assert formation == pytest.approx(1 + 1, abs=1e-5)
    assert flight == pytest.approx(1.0 * 1.0 + 0.5 * 0.9 + 0.1, abs=1e-5)
    assert obstacle == 0
    assert action == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(("metres", "counted"), [(0.7, 0.7), (9.0, 4.0), (-0.7, 0.0)])
def test_a_drone_behind_its_schedule_pays_for_every_metre_up_to_the_reach(make_env, metres, counted):
    env, carefree = (unscaled(make_env, f"reward.flight.lag.weight={weight}") for weight in (1.5, 0.0))

    def placed(position):
        on_time = env.slots + position.new_tensor(env.world.scenario.start)
        on_time = on_time + 11 * env.dt * position.new_tensor(env.world.scenario.velocity)
        return (on_time - position.new_tensor([0.0, metres, 0.0])).expand_as(position)

    cost = cruise(carefree, position=placed)[0] - cruise(env, position=placed)[0]
    torch.testing.assert_close(cost[:, FLIGHT], torch.full((3,), 1.5 * counted, dtype=env.dtype))


def test_a_team_beside_its_corridor_pays_and_so_does_a_torn_one(make_env):
    env = unscaled(make_env)

    def aside(position):
        return position + position.new_tensor([2.0 + 0.5, 0.0, 0.0])

    centred, _ = cruise(env)
    outside, _ = cruise(env, position=aside)
    lateral = aside(env.reset(scenarios.sample(env.world.scenario, 1, 0, dtype=env.dtype)).position)[0, :, 0]
    centring = 0.1 * lateral.mean().square()
    penalty = 4.0 * ((lateral - 2.0).clamp_min(0) / 0.5).square()
    torch.testing.assert_close((centred - outside)[:, FLIGHT], penalty + centring)

    def torn(position):
        return position + position.new_tensor([[0.0, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.0]])

    tethered = cruise(env, position=torn)
    loose = cruise(unscaled(make_env, "reward.formation.tether=0"), position=torn)
    cost = 0.5 * tethered[1].formation_error
    assert cost.item() > 0.1
    torch.testing.assert_close((loose[0] - tethered[0])[:, 0], cost.expand(3))


def test_shaped_failure_is_charged_to_the_drone_that_failed_in_every_objective(make_env):
    env = unscaled(make_env, reward="shaped")
    fine, _ = cruise(env)

    def sink(position):
        lower = position.clone()
        lower[0, 0, 2] = 0.1
        return lower

    failed, _ = cruise(env, position=sink)
    assert (fine - failed)[0, OBJECTIVES.index("action")].item() == pytest.approx(5)
    assert (fine - failed)[1, OBJECTIVES.index("action")].item() == pytest.approx(0)


@pytest.mark.parametrize("reward", ["shaped", "smooth", "paper", "release"])
def test_every_reward_is_finite_along_a_rough_flight(make_env, reward):
    env = make_env("scenario=mixed", f"reward={reward}", dtype=torch.float32)
    drawn = scenarios.sample(env.world.scenario, 8, 0)
    state = env.reset(drawn)
    generator = torch.Generator().manual_seed(0)
    for _ in range(60):
        action = command(env, 8) + 0.3 * torch.randn(8, 3, 4, generator=generator)
        state, value, _ = env.step(state, action, drawn)
        assert value.shape == (8, 3, 4)
        assert value.isfinite().all()


def test_each_objective_is_divided_by_its_scale(make_env):
    bare, _ = cruise(unscaled(make_env, reward="paper", scenario="mixed"))
    shares = (f"reward.scale.{name}={2**k}" for k, name in enumerate(OBJECTIVES))
    scaled, _ = cruise(make_env("scenario=mixed", "reward=paper", *shares))
    torch.testing.assert_close(scaled * torch.tensor([1.0, 2.0, 4.0, 8.0], dtype=bare.dtype), bare)


@pytest.mark.parametrize(
    ("changes", "answer"),
    [
        (
            {"flight": {"sped": 1.0}},
            "reward.flight.sped: there is no such term; envs/terms.py has failure, team_failure",
        ),
        (
            {"flight": {"lag": 1.0}},
            "reward.flight.lag.reach is missing: write reward.flight.lag={weight: 1, reach: VALUE}",
        ),
        (
            {"flight": {"lag": {"weight": 1.0, "reach": 1.0, "far": 1.0}}},
            "unknown key reward.flight.lag.far: lag takes reach, weight",
        ),
        ({"flight": {"lag": {"reach": 1.0}}}, "reward.flight.lag.weight is missing: set it with"),
        (
            {"scale": {"action": 1.0}},
            "reward.scale needs a number above 0 for each of formation, flight, obstacle, action",
        ),
    ],
)
def test_terms_that_cannot_be_used_are_refused(make_env, changes, answer):
    with pytest.raises(ValueError, match=re.escape(answer)):
        replace(make_env("reward=smooth").world.reward, **changes)


def test_a_wrong_scale_on_the_command_line_is_refused_in_one_line(make_env):
    with pytest.raises(ConfigError, match=r"^reward\.scale needs a number above 0"):
        make_env("reward=smooth", "reward.scale.action=0")
