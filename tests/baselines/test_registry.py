"""Baselines by name; what cannot be made, and worlds that a method cannot fly in, say why in one line."""

from dataclasses import asdict, replace

import pytest
import torch

from baselines import registry
from envs.scenarios import sample
from formctl.settings import choices
from tests.baselines import example
from tests.baselines.conftest import compose

NAMES = choices("baseline")


def test_sanity_agents_are_registered():
    assert {"hover", "straight_line"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_flies_the_number_of_drones_it_says(name, make_env, make_agent):
    known = registry.capabilities(name, compose(f"baseline={name}").baseline)
    drone = ["drone=crazyflie_rotor"] if known.command == "rotor" else []
    env = make_env("scenario=free", "scenario.formation=pentagon", *drone)
    most = known.max_drones
    if most is not None and most < 5:
        with pytest.raises(ValueError, match=f"flies at most {most} drones"):
            make_agent(name, env)
        return
    scenarios = sample(env.world.scenario, 1, 0, torch.float64)
    agent, state = make_agent(name, env), env.reset(scenarios)
    agent.reset(scenarios, state)
    assert agent.act(state, scenarios).shape == (1, 5, 4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"target": "baselines.sanity.Nobody"}, "target 'baselines.sanity.Nobody' cannot be imported"),
        ({"target": "nowhere"}, "target 'nowhere' cannot be imported"),
        ({"target": "baselines.sanity.HoverSpec"}, "is no agent: see baselines.protocol.Agent"),
        ({"speed": 3}, "baseline.speed: Unexpected keyword argument"),
        ({"acceleration": "fast"}, "baseline.acceleration: Input should be a valid number"),
        ({"acceleration": 0.0}, "never reaches v\\*"),
    ],
)
def test_what_cannot_be_made_says_why(changes, message, make_env):
    gains = {
        "position_gain": 6.0,
        "velocity_gain": 4.0,
        "attitude_gain": [10.0, 10.0, 5.0],
        "max_tilt": 0.785,
        "thrust_reserve": 0.1,
    }
    settings = {"target": "baselines.sanity.StraightLine", "acceleration": 4.0, "tracker": gains} | changes
    with pytest.raises(ValueError, match=message) as caught:
        registry.make("test", make_env("scenario=free"), settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("world", "limits", "message"),
    [
        (["scenario.formation=pentagon"], {"max_drones": 4}, "flies at most 4 drones, the formation has 5"),
        ([], {"min_drones": 4}, "flies at least 4 drones, the formation has 3"),
        ([], {"command": "rotor"}, "commands rotor, this world takes ctbr"),
        (["scenario.balls=1", "scenario.sensing_range=0"], {}, "has to see balls fly: give scenario.sensing_range"),
    ],
)
def test_a_world_that_does_not_fit_is_refused_in_one_line(world, limits, message, make_env, monkeypatch):
    monkeypatch.setattr(example.Straight, "capabilities", replace(example.Straight.capabilities, **limits))
    settings = {"target": "tests.baselines.example.Straight", **asdict(example.spec())}
    with pytest.raises(ValueError, match=f"baseline 'test' {message}") as caught:
        registry.make("test", make_env("scenario=free", *world), settings)
    assert "\n" not in str(caught.value)


def test_a_planner_is_made_from_its_yaml(make_env):
    settings = {"target": "tests.baselines.example.Straight", **asdict(example.spec("feed_forward"))}
    agent = registry.make("test", make_env("scenario=free"), settings)
    assert agent.spec == example.spec("feed_forward") and agent.name == "test"
