"""Wind and gusts against closed forms: Dryden's spectra, the profile near the ground, and drag."""

import math

import numpy as np
import pytest
import torch

from envs import air
from envs.deployment import environment
from envs.formation import FormationEnv
from envs.mujoco_env import MujocoFormationEnv
from envs.scenarios import sample, select
from formctl.settings import compose
from tests.envs.test_dynamics import command

torch.set_num_threads(1)


def along_spectrum(x):
    return 2 / math.pi / (1 + x**2)


def across_spectrum(x):
    return (1 + 3 * x**2) / (1 + x**2) ** 2 / math.pi


@pytest.mark.parametrize(
    ("numbers", "spectrum"), [(air.along_wave_numbers, along_spectrum), (air.across_wave_numbers, across_spectrum)]
)
def test_wave_numbers_divide_the_energy_of_drydens_spectra(numbers, spectrum):
    """The integral of the spectrum up to the wave number of a share is that share."""
    for share in (0.05, 0.3, 0.6, 0.9, 0.98):
        end = numbers(torch.tensor([share], dtype=torch.float64)).item()
        x = np.linspace(0, end, 200_001)
        assert np.trapezoid(spectrum(x), x) == pytest.approx(share, abs=2e-5)


def test_lengths_and_intensities_near_the_ground():
    """MIL-F-8785C at 100 ft: L_u = 246 m, sigma_u / sigma_w = 1.72; below 10 ft they stay."""
    (long, across, up), (strong, _, vertical) = air.turbulence(100 * 0.3048)
    ratio = 0.177 + 0.0823
    assert long == across == pytest.approx(100 / ratio**1.2 * 0.3048)
    assert up == pytest.approx(30.48)
    assert strong / vertical == pytest.approx(ratio**-0.4)
    assert air.turbulence(1.0) == air.turbulence(3.0)
    assert air.wind_at_20_feet(torch.tensor(2.0), 20 * 0.3048).item() == pytest.approx(2.0)
    assert air.wind_at_20_feet(torch.tensor(2.0), 1.0).item() == pytest.approx(
        2 * math.log(20 / 0.15) / 3.0858, rel=1e-3
    )


def drawn(make_env, *words, episodes=400):
    env = make_env("scenario=real", *words)
    return env, sample(env.world.scenario, episodes, 3, torch.float64)


def met(env, scenarios, seconds, dt):
    """Velocity of the air (E, T, 3) in m/s that a drone meets which flies at v* from the origin."""
    times = torch.arange(0, seconds, dt, dtype=torch.float64)
    flown = torch.tensor(env.world.scenario.velocity, dtype=torch.float64) * times[:, None]
    one = torch.zeros(len(scenarios.id), dtype=torch.float64)
    steps = [
        air.velocity(scenarios.wind, place.expand(len(one), 1, 3), one + t)
        for place, t in zip(flown, times, strict=True)
    ]
    return torch.cat(steps, 1)


def test_gusts_have_drydens_variance_and_correlation(make_env):
    """At airspeed V gusts along the wind decay as exp(-V t / L), those across as (1 - V t / 2 L) exp(-V t / L)."""
    env, scenarios = drawn(make_env, "scenario.air.wind=[3,3]", episodes=2000)
    steady = scenarios.wind[:, 0, :3]
    gusts = met(env, scenarios, 6.0, 1.0) - steady[:, None]
    along = (gusts * steady[:, None] / 3).sum(-1)
    across = (gusts[..., 0] * -steady[:, None, 1] + gusts[..., 1] * steady[:, None, 0]) / 3
    lengths, shares = air.turbulence(1.0)
    w20 = air.wind_at_20_feet(torch.tensor(3.0), 1.0).item()
    for component, share in ((along, shares[0]), (across, shares[1]), (gusts[..., 2], shares[2])):
        assert component.std().item() == pytest.approx(share * w20, rel=0.05)
        assert abs(component.mean().item()) < 0.05 * share * w20
    speed = torch.linalg.vector_norm(torch.tensor(env.world.scenario.velocity) - steady, dim=-1)
    for lag in (1, 3, 5):
        path = speed * lag / lengths[0]
        expected = (-path).exp().mean().item()
        found = ((along[:, lag] * along[:, 0]).mean() / along.square().mean()).item()
        assert found == pytest.approx(expected, abs=0.06)
        expected = ((1 - path / 2) * (-path).exp()).mean().item()
        found = ((across[:, lag] * across[:, 0]).mean() / across.square().mean()).item()
        assert found == pytest.approx(expected, abs=0.06)


def test_the_air_is_frozen_and_carried_along(make_env):
    """Somebody who drifts with the wind feels no change."""
    _, scenarios = drawn(make_env, "scenario.air.wind=[1,4]", episodes=5)
    steady = scenarios.wind[:, :1, :3]
    place, time = torch.tensor([0.5, 2.0, 1.0], dtype=torch.float64), torch.full((5,), 7.0, dtype=torch.float64)
    first = air.velocity(scenarios.wind, place.expand(5, 1, 3), 0 * time)
    torch.testing.assert_close(air.velocity(scenarios.wind, place + 7 * steady, time), first)


def test_steady_wind_comes_from_everywhere_and_episodes_are_their_own(make_env):
    _, scenarios = drawn(make_env, "scenario.air.wind=[1,3]", "scenario.air.gusts=0", episodes=1000)
    steady = scenarios.wind[:, 0, :3]
    speed = torch.linalg.vector_norm(steady, dim=-1)
    assert 1 <= speed.min() < 1.05 and 2.95 < speed.max() <= 3 + 1e-6
    assert steady.mean(0).abs().max() < 0.15 and not steady[:, 2].any()
    assert not scenarios.wind[:, 1:, :3].any()
    _, few = drawn(make_env, "scenario.air.wind=[1,3]", "scenario.air.gusts=0", episodes=3)
    assert torch.equal(few.wind, select(scenarios, slice(0, 3)).wind)


@pytest.mark.parametrize("kind", [FormationEnv, MujocoFormationEnv])
@pytest.mark.parametrize("deployed", [False, True])
def test_wind_carries_a_level_drone_away(make_env, kind, deployed):
    """v = W (1 - exp(-c t)) in steady wind, from the scenario or from the deployment."""
    quiet = (
        "scenario.attitude_jitter=0",
        "drone.downwash_axial=-1",
        "drone.linear_damping=0.5",
        "drone.angular_damping=0",
    )
    if deployed:
        spec = compose(["deploy=ideal", "deploy.wind=[2,2]", "deploy.gusts=0"]).deploy
        env = environment(kind, make_env(*quiet).world, spec, dtype=torch.float64)
    else:
        env = kind(
            make_env("scenario=real", *quiet, "scenario.air.wind=[2,2]", "scenario.air.gusts=0").world, torch.float64
        )
    scenarios = sample(env.world.scenario, 4, 0, torch.float64)
    state = env.reset(scenarios)
    for _ in range(50):
        state, _, _ = env.step(state, command(env, 4), scenarios)
    waves = env._wind if deployed else scenarios.wind
    expected = waves[:, :1, :3] * (1 - math.exp(-0.5))
    torch.testing.assert_close(state.velocity, expected.expand_as(state.velocity), rtol=0.01, atol=1e-6)


def test_wind_that_was_drawn_is_the_same_whoever_flies_with_it(make_env):
    spec = compose(["deploy=mocap", "deploy.wind=[0,3]"]).deploy
    env = environment(FormationEnv, make_env("scenario=real").world, spec, dtype=torch.float64)
    scenarios = sample(env.world.scenario, 5, 0, torch.float64)
    env.reset(scenarios)
    together = env._wind.clone()
    env.reset(select(scenarios, slice(3, 4)))
    assert torch.equal(env._wind[0], together[3]) and not torch.equal(together[2], together[3])
