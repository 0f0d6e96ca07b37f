"""Simulated time: latencies and links, by counting."""

import numpy as np
import pytest

from baselines.planner.interface import Links
from baselines.planner.messages import Bus, Due
from baselines.planner.sight import task
from envs.formation import FormationEnv
from envs.scenarios import sample
from tests.envs.conftest import make_world


def bus(delay=0.05, loss=0.0, drones=3, seed=0):
    return Bus(drones, delay, loss, np.random.default_rng(seed))


def test_due_hands_out_in_order_of_time_then_of_putting():
    due = Due()
    for time, item in ((0.3, "late"), (0.1, "first"), (0.1, "second")):
        due.put(time, item)
    assert due.take(0.05) == [] and len(due) == 3
    assert due.take(0.1) == ["first", "second"]
    assert due.take(0.1 + 0.2 - 1e-12) == ["late"] and len(due) == 0


def test_due_is_not_late_for_rounding():
    due = Due()
    due.put(0.1 + 0.2, "now")  # 0.30000000000000004
    assert due.take(0.3) == ["now"]


def test_messages_reach_everybody_else_after_the_delay():
    links = bus(0.05)
    links.send(1.0, sender=1, content="plan")
    assert links.receive(1.04, 0) == []
    (message,) = links.receive(1.06, 0)
    assert message == (1, 1.0, pytest.approx(1.05), "plan")
    assert links.receive(1.06, 0) == [] and links.receive(9.0, 1) == [] and len(links.receive(9.0, 2)) == 1


def test_every_link_has_its_own_delay_and_keeps_the_order():
    links = bus(np.array([[0, 0.1, 0.0], [0, 0, 0], [0, 0.02, 0]]))
    links.send(0.0, 0, "slow")
    links.send(0.02, 2, "fast")
    assert [message.content for message in links.receive(1.0, 1)] == ["fast", "slow"]
    assert [message.content for message in links.receive(0.0, 2)] == ["slow"]


def received(loss, seed=0, count=500):
    links = bus(0.0, loss, seed=seed)
    for number in range(count):
        links.send(0.0, 0, number)
    return [message.content for message in links.receive(0.0, 1)]


def test_a_share_of_the_messages_is_lost_and_the_seed_decides_which():
    some = received(0.3)
    assert 0.62 * 500 < len(some) < 0.78 * 500
    assert received(0.3) == some != received(0.3, seed=1)
    assert set(received(0.6)) < set(some) < set(received(0.0)) == set(range(500))
    assert received(1.0) == []


@pytest.mark.parametrize(("delay", "loss", "message"), [(-0.1, 0.0, "link delay"), (0.0, 1.5, "share")])
def test_impossible_links_are_refused(delay, loss, message):
    with pytest.raises(ValueError, match=message):
        bus(delay, loss)


def test_an_episode_with_links_of_its_own_decides_instead():
    """Sent in the first tenth of a second: lost to drone 1, 0.3 s late to drone 2; then prompt; then as at first."""
    delays = np.zeros((3, 3, 2))
    delays[0, 1, 0], delays[0, 2, 0] = np.inf, 0.3
    own = Bus(3, 9.0, 1.0, np.random.default_rng(0), Links(0.1, delays))
    for time in (0.0, 0.06, 0.1, 0.15, 0.2):
        own.send(time, 0, time)
    assert [message.sent for message in own.receive(1.0, 1)] == [0.1, 0.15]
    assert [message.sent for message in own.receive(0.37, 2)] == [0.1, 0.15, 0.0, 0.06]
    assert [message.received for message in own.receive(1.0, 2)] == pytest.approx([0.5])


def test_a_scenario_with_messages_links_its_planners():
    world = make_world("scenario=mixed", "scenario.messages.period=0.1", "scenario.messages.delay=[0.05,0.05]")
    env = FormationEnv(world)
    scenarios = sample(world.scenario, 1, 0)
    links = task(env, scenarios).links
    assert links is not None and links.period == 0.1
    assert links.delays == pytest.approx(scenarios.delays[0].numpy())
    quiet = make_world("scenario=mixed")
    assert task(FormationEnv(quiet), sample(quiet.scenario, 1, 0)).links is None
