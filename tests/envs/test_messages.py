"""Messages between drones: what is known, how old it is, and that nothing changes where there are none."""

import math
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import torch

from envs import messages
from envs.formation import FormationEnv
from envs.mujoco_env import MujocoFormationEnv
from envs.scenarios import sample, select
from tests.envs.conftest import make_world
from tests.envs.test_dynamics import command

torch.set_num_threads(1)

EVERY = "scenario.messages.period=0.02"
TENTH = "scenario.messages.period=0.1"


def law(*words):
    return make_world("scenario=mixed", *words).scenario


def flown(env, episodes=3, steps=40, seed=0):
    """The states of a wobbling flight, with its scenarios."""
    scenarios = sample(env.world.scenario, episodes, 0, env.dtype)
    generator = torch.Generator().manual_seed(seed)
    states = [env.reset(scenarios)]
    for _ in range(steps):
        noise = 0.2 * torch.randn(episodes, env.drones, 4, generator=generator, dtype=env.dtype)
        states.append(env.step(states[-1], command(env, episodes) + noise, scenarios)[0])
    return states, scenarios


def known(env, state, scenarios):
    return messages.neighbours(state, scenarios, env.time(state), env.world.scenario.messages)


@pytest.mark.parametrize("shown", ["paper", "release"])
def test_prompt_messages_are_perfect_knowledge(make_env, shown):
    """One message a command, no delay, no loss: bit for bit what is seen without messages."""
    without, with_messages = (make_env("scenario=mixed", f"observation={shown}", *words) for words in ((), (EVERY,)))
    states, scenarios = flown(without)
    others, told = flown(with_messages)
    assert states[0].told.shape[2] == 0 and others[0].told.shape[2] == 100
    for state, other in zip(states, others, strict=True):
        seen, heard = without.observe(state, scenarios), with_messages.observe(other, told)
        assert all(torch.equal(seen[name], heard[name]) for name in seen)


def test_a_message_is_extrapolated_from_when_it_left(make_env):
    """0.13 s late, every 0.1 s: at step 17 (0.34 s) the newest that has arrived left at 0.2 s."""
    env = make_env("scenario=mixed", TENTH, "scenario.messages.delay=[0.13,0.13]", "scenario.messages.jitter=0")
    states, scenarios = flown(env)
    for step, left in ((17, 10), (16, 0), (12, 0), (11, 0), (30, 20), (31, 20), (32, 25)):
        left = {16: 5, 12: 5, 11: 0}.get(step, left)
        seen = known(env, states[step], scenarios)
        age = 0.02 * (step - left)
        torch.testing.assert_close(seen.age, torch.full_like(seen.age, age))
        then = states[left]
        expected = then.position + age * then.velocity
        torch.testing.assert_close(seen.position[:, 0], expected[:, 1:])
        torch.testing.assert_close(seen.velocity[:, 2], then.velocity[:, :2])


def test_before_anything_was_heard_they_stand_where_they_start(make_env):
    env = make_env("scenario=mixed", TENTH, "scenario.messages.delay=[0.5,0.5]", "scenario.messages.jitter=0")
    states, scenarios = flown(env, steps=10)
    seen = known(env, states[10], scenarios)
    torch.testing.assert_close(seen.position[:, 0], scenarios.position[:, 1:])
    assert not seen.velocity.any() and seen.age.min() == pytest.approx(0.5)


def test_the_newest_message_counts_even_when_it_overtakes(make_env):
    env = make_env("scenario=mixed", TENTH, "scenario.messages.delay=[0.1,0.1]")
    states, scenarios = flown(env, episodes=1, steps=15)
    slow, fast = 0.28, 0.02
    delays = torch.full_like(scenarios.delays, math.inf)
    delays[..., 0], delays[..., 1] = slow, fast
    scenarios = scenarios._replace(delays=delays)
    ages = [known(env, states[step], scenarios).age[0, 0, 0].item() for step in (5, 6, 14, 15)]
    assert ages[1:] == pytest.approx([0.02, 0.18, 0.2], abs=1e-6)
    assert ages[0] == pytest.approx(2.0 - 0.1 + 0.0, abs=0.11)  # nothing yet: as old as the horizon


def test_delays_and_losses_follow_their_law():
    spec = law(TENTH, "scenario.messages.delay=[0.1,0.1]", "scenario.messages.loss=[0.3,0.3]")
    delays = sample(spec, 300, 0).delays.numpy()
    assert delays.shape == (300, 3, 3, 180)
    lost = np.isinf(delays)
    assert lost.mean() == pytest.approx(0.3, abs=0.01)
    ended = lost[..., :-1] & ~lost[..., 1:]
    assert lost[..., :-1].sum() / ended.sum() == pytest.approx(3.0, rel=0.05)  # messages lost in a row
    came = delays[~lost]
    assert came.mean() == pytest.approx(0.1, rel=0.01)
    assert came.std() == pytest.approx(0.05, rel=0.02)
    skew = ((came - came.mean()) ** 3).mean() / came.std() ** 3
    assert skew == pytest.approx(2 * 0.5, rel=0.1)  # Gamma: twice the coefficient of variation


def test_every_flight_has_its_own_means_and_depends_on_no_other():
    spec = law(TENTH, "scenario.messages.delay=[0.0,0.2]", "scenario.messages.loss=[0.0,0.4]")
    few, many = (sample(spec, count, 0) for count in (3, 600))
    assert torch.equal(few.delays, many.delays[:3])
    lost = many.delays.isinf()
    means = torch.where(lost, 0, many.delays).sum((1, 2, 3)) / (~lost).sum((1, 2, 3))
    assert means.min() < 0.01 and means.max() > 0.19
    shares = lost.double().mean((1, 2, 3))
    assert shares.min() < 0.02 and 0.3 < shares.max() < 0.5
    assert sample(law(), 3, 0).delays.shape[-1] == 0


def test_both_physics_tell_alike(make_env):
    env = make_env("scenario=mixed", TENTH)
    other = MujocoFormationEnv(env.world, torch.float64, contacts=False)
    here, there = flown(env)[0][-1], flown(other)[0][-1]
    assert here.told.abs().max() > 0
    torch.testing.assert_close(here.told, there.told, atol=1e-6, rtol=0)


def test_gradients_flow_through_what_was_told(make_env):
    """What drone 0 sees of drone 1 depends on what drone 1 was commanded before its message left, not after."""
    env = make_env("scenario=mixed", TENTH, "scenario.messages.delay=[0.08,0.08]", "scenario.messages.jitter=0")
    scenarios = sample(env.world.scenario, 2, 0, env.dtype)
    actions = [(command(env, 2) + 0.1).requires_grad_() for _ in range(10)]
    state = env.reset(scenarios)
    for action in actions:
        state, _, _ = env.step(state, action, scenarios)
    known(env, state, scenarios).position[:, 0, 0].sum().backward()  # at 0.2 s: left at 0.1 s, after five commands
    size = [action.grad[:, 1].abs().max().item() for action in actions]
    assert min(size[:4]) > 1e-6 and max(size[5:]) == 0
    assert max(action.grad[:, 0].abs().max().item() for action in actions) < 1e-12


def test_telling_and_hearing_compile(make_env):
    """Each is one graph: no branch on what was told."""
    env = make_env("scenario=mixed", TENTH, "scenario.messages.delay=[0.1,0.1]", "scenario.messages.loss=[0.2,0.2]")
    spec, (states, scenarios) = env.world.scenario.messages, flown(env, steps=8)
    trace = partial(torch.compile, backend="eager", fullgraph=True, dynamic=False)
    tell, neighbours = trace(messages.tell), trace(messages.neighbours)
    for before, after in pairwise(states):
        told = tell(after._replace(told=before.told), env.time(before), env.time(after), spec).told
        assert torch.equal(told, after.told)
        heard = neighbours(after, scenarios, env.time(after), spec)
        for fast, plain in zip(heard, known(env, after, scenarios), strict=True):
            torch.testing.assert_close(fast, plain)


def test_age_is_one_more_number(make_env):
    env = make_env("scenario=mixed", TENTH, "observation.message_age=true", "scenario.messages.loss=[0.3,0.3]")
    states, scenarios = flown(env, steps=12)
    seen = env.observe(states[-1], scenarios)["drones"]
    assert seen.shape[-1] == env.layout.drones_dim == 8
    assert torch.equal(seen[..., 7], known(env, states[-1], scenarios).age)
    silent = make_env("scenario=mixed", "observation.message_age=true")
    states, scenarios = flown(silent, steps=3)
    assert not silent.observe(states[-1], scenarios)["drones"][..., 7].any()


def test_an_episode_hears_the_same_in_any_company(make_env):
    env = make_env("scenario=mixed", TENTH, "scenario.messages.delay=[0,0.2]", "scenario.messages.loss=[0,0.4]")
    states, scenarios = flown(env)
    one = slice(2, 3)
    alone = type(states[-1])(*(field[one] for field in states[-1]))
    seen = known(env, alone, select(scenarios, one))
    assert torch.equal(seen.position, known(env, states[-1], scenarios).position[one])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["scenario.messages.period=0.03"], "is not a multiple of the control period"),
        ([TENTH, "scenario.messages.horizon=0.05"], "is shorter than the period"),
        ([TENTH, "scenario.messages.loss=[0,0.8]"], r"use scenario\.messages\.burst=4 or more"),
    ],
)
def test_what_cannot_be_is_refused(words, message):
    with pytest.raises(ValueError, match=message):
        FormationEnv(make_world("scenario=mixed", *words))
