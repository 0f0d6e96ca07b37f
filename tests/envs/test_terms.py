"""Every term against its value worked out by hand, on one step made up for it."""

import math

import pytest
import torch

from envs import dynamics, scenarios, terms
from envs.spec import FAR, Events
from envs.step_view import StepView


@pytest.fixture
def step(make_env):
    """Makes one step of a triangle in cruise at 2 m/s without obstacles; keywords replace parts of the view.

    ``state`` and ``events`` are dicts of replacements in the parts themselves.
    """

    def make(*, state=None, events=None, **changes):
        env = make_env("scenario=mixed", "scenario.columns=2", "scenario.balls=2")
        drawn = scenarios.sample(env.world.scenario, 1, 0, dtype=env.dtype)
        start = env.reset(drawn)
        forward = torch.tensor([0.0, 2.0, 0.0], dtype=env.dtype)
        start = start._replace(velocity=forward.expand_as(start.velocity))
        end = start._replace(step=start.step + 50, position=start.position + forward * 50 * env.dt)
        end = end._replace(**{name: change(getattr(end, name)) for name, change in (state or {}).items()})
        far, zero = torch.full((1, 3), FAR, dtype=env.dtype), torch.zeros(1, 3, dtype=env.dtype)
        happened = Events(far, far, torch.full_like(far, 1.732), zero[:, 0], zero[:, 0], zero, zero)
        happened = happened._replace(
            **{
                name: torch.tensor(value, dtype=env.dtype).expand_as(getattr(happened, name))
                for name, value in (events or {}).items()
            }
        )
        view = StepView(
            before=start,
            state=end,
            events=happened,
            column_distance=far[..., None].expand(1, 3, 2),
            ball_distance=far[..., None].expand(1, 3, 2),
            ball_position=torch.tensor([[[0.0, 9.0, 2.0]] * 2], dtype=env.dtype),
            ball_velocity=torch.tensor([[[0.0, -3.0, -1.0]] * 2], dtype=env.dtype),
            ball_thrown=torch.tensor([[False, False]]),
            ball_flying=torch.tensor([[False, False]]),
            last=torch.tensor([False]),
            crashed=torch.zeros(1, 3, dtype=torch.bool),
            slots=env.slots,
            scenarios=drawn,
            scenario=env.world.scenario,
            drone=env.world.drone,
        )
        return view._replace(**changes)

    return make


def moved(drone, axis, metres):
    """A change of the state's position: one drone, by so many metres along an axis."""

    def change(position):
        position = position.clone()
        position[0, drone, axis] += metres
        return position

    return {"position": change}


def moving(*velocity):
    return {"velocity": lambda v: torch.tensor(velocity, dtype=v.dtype).expand_as(v)}


def turning(*rates):
    return {"rates": lambda r: torch.tensor(rates, dtype=r.dtype).expand_as(r)}


FLYING = {"ball_thrown": torch.tensor([[True, False]]), "ball_flying": torch.tensor([[True, False]])}
LANDED = {"ball_thrown": torch.tensor([[True, True]])}


def near(metres):
    """Distances (1, 3, 2): the first obstacle so near to the first drone, everything else far away."""
    distance = torch.full((1, 3, 2), FAR, dtype=torch.float64)
    distance[0, 0, 0] = metres
    return distance


CASES = [
    # term, parameters, step, value of the first drone
    ("failure", {}, {"events": {"column": [[0.1, 9.0, 9.0]]}}, -1),
    ("failure", {}, {"events": {"column": [[9.0, 0.1, 9.0]]}}, 0),
    ("team_failure", {}, {"events": {"ball": [[9.0, 0.1, 9.0]]}}, -1),
    ("finish", {}, {"last": torch.tensor([True])}, 1),
    ("finish", {}, {}, 0),
    ("size", {}, {"events": {"formation_error": [3.0]}}, 0.25),
    ("tether", {}, {"events": {"formation_error": [3.0]}}, -3),
    ("shape", {"sharpness": 10.0}, {"events": {"shape_error": [0.1]}}, 0.5),
    ("spread", {"reach": 0.6}, {"events": {"drone": [[0.2, 0.2, 1.7]]}}, -1),
    ("spread", {"reach": 0.6}, {"events": {"drone": [[1.7, 0.4, 0.4]]}}, -0.25),
    ("speed", {}, {"state": moving(0.0, 2.0, 0.0)}, 1),
    ("speed", {}, {"state": moving(0.0, 2.0 - math.sqrt(3), 0.0)}, 0.5),
    ("height", {}, {"state": moved(0, 2, math.sqrt(0.15))}, 1 - 0.4),
    ("heading", {}, {}, 1),
    (
        "heading",
        {},
        {
            "state": {
                "attitude": lambda q: torch.tensor(
                    [math.cos(math.pi / 6), 0, 0, math.sin(math.pi / 6)], dtype=q.dtype
                ).expand_as(q)
            }
        },
        0.5,
    ),
    ("lag", {"reach": 4.0}, {"state": moved(0, 1, -0.7)}, -0.7),
    ("lag", {"reach": 4.0}, {"state": moved(0, 1, -9.0)}, -4),
    ("lag", {"reach": 4.0}, {"state": moved(0, 1, 0.7)}, 0),
    ("centring", {}, {"state": moved(0, 0, 3.0)}, -1),
    ("corridor", {"reach": 2.0}, {"state": moved(0, 0, 2.0)}, -4),  # from x = 1 m to 3 m
    ("corridor", {"reach": 2.0}, {}, 0),
    ("column", {"reach": 0.7}, {"column_distance": near(0.2)}, -1),
    ("ball", {"reach": 1.0}, {"ball_distance": near(0.7)}, -0.25),
    ("command_change", {}, {"events": {"command_change": 0.3}}, -0.09),
    ("throttle_change", {}, {"events": {"throttle_change": 0.2}}, -0.04),
    ("yaw_rate", {}, {"state": turning(1.0, 2.0, 3.0)}, -9),
    ("tilt_rate", {}, {"state": turning(1.0, 2.0, 3.0)}, -5),
    ("paper_shape", {}, {"events": {"shape_error": [0.25]}}, 0.8),
    ("paper_size", {}, {}, 1),
    ("paper_size", {}, {"state": moved(0, 0, 1.0)}, 1 / (1 + (math.sqrt(7) - math.sqrt(3)) ** 2)),
    ("paper_distance", {"threshold": 0.4}, {}, 0),
    ("paper_distance", {"threshold": 2.0}, {}, -1),
    (
        "paper_heading",
        {},
        {"state": {"attitude": lambda q: torch.tensor([0.0, 0, 0, 1.0], dtype=q.dtype).expand_as(q)}},
        -1,
    ),
    ("paper_velocity", {}, {"state": moving(0.3, 2.0, 0.4)}, 0.5),
    ("paper_position", {}, {"state": moved(0, 0, 1.0)}, 0.5),
    ("paper_height", {}, {"state": moved(0, 2, -0.3)}, 0.7),
    ("paper_obstacle", {"reach": 1.0}, {"events": {"column": 0.6, "ball": 0.4}}, -0.6),
    ("paper_obstacle", {"reach": 1.0}, {}, 0),
    ("paper_network", {}, {"events": {"command_change": 0.3}}, 0.7),
    ("paper_throttle_change", {}, {"events": {"throttle_change": 0.2}}, 0.8),
    ("paper_throttle", {}, {"state": {"throttle": lambda t: t + 0.1}}, 0.6),
    ("paper_yaw", {}, {"state": turning(1.0, 2.0, -3.0)}, -2),
    ("release_size", {"busy_air": 0.2, "all_landed": 0.5}, {}, 2),
    ("release_size", {"busy_air": 0.2, "all_landed": 0.5}, FLYING, 0.4),
    ("release_size", {"busy_air": 0.2, "all_landed": 0.5}, LANDED, 3),
    ("release_shape", {"busy_air": 0.2}, {"events": {"shape_error": [0.04]}}, 0.44),
    ("release_shape", {"busy_air": 0.2}, {"events": {"shape_error": [0.04]}, **FLYING}, 0.088),
    ("release_touch", {}, {}, 0),
    ("release_touch", {}, {"state": {"position": lambda p: p * 0.05}}, -1),
    ("release_height", {"busy_air": 0.2}, {"state": moved(0, 2, 0.3)}, 0.7),
    ("release_height", {"busy_air": 0.2}, {"state": moved(0, 2, 0.3), **FLYING}, 0.028),
    ("release_height", {"busy_air": 0.2}, {"state": moved(0, 2, 1.2)}, 0),
    ("release_velocity", {"busy_air": 0.2}, {"state": moving(0.3, 2.0, 0.4)}, 1.5),
    ("release_heading", {"busy_air": 0.2}, FLYING, 0.2),
    ("release_position", {"busy_air": 0.2}, {}, 0),
    ("release_position", {"busy_air": 0.2}, {"last": torch.tensor([True])}, 1 / (1 + 32.4 - 2.0)),
    (
        "release_ball",
        {"slope": 25.0, "hard": 0.4, "soft": 0.6, "far_cap": 0.0},
        {"ball_distance": near(0.5), **FLYING},
        -2.5,
    ),
    (
        "release_ball",
        {"slope": 25.0, "hard": 0.4, "soft": 0.6, "far_cap": 0.0},
        {"ball_distance": near(0.3), **FLYING},
        -15,
    ),
    ("release_ball", {"slope": 25.0, "hard": 0.4, "soft": 0.6, "far_cap": 0.0}, {"ball_distance": near(0.3)}, 0),
    ("release_column", {"reach": 0.4}, {"column_distance": near(0.3)}, -0.1),
    ("release_nearest_column", {"reach": 0.4}, {"events": {"column": 0.1}}, -0.25),
    ("release_hit", {}, {"events": {"column": 0.1, "ball": 0.1}}, -2),
    ("release_throttle", {"offset": 2.5}, {"state": {"throttle": lambda t: 0 * t + 0.5}}, 0.5),
    ("release_network", {}, {"events": {"command_change": 0.5}}, 2),
    ("release_yaw", {}, {"state": turning(0.0, 0.0, -0.5)}, 1),
    ("release_throttle_change", {}, {"events": {"throttle_change": 0.2}}, 0.3),
]


@pytest.mark.parametrize(("name", "parameters", "words", "value"), CASES, ids=[case[0] for case in CASES])
def test_a_term_has_the_value_worked_out_by_hand(step, name, parameters, words, value):
    found = terms.TERMS[name](step(**words), **parameters)
    assert found.shape in ((1, 3), (1, 1))
    assert found[0, 0].item() == pytest.approx(value, abs=1e-6)


def test_no_term_is_untested():
    assert set(terms.TERMS) == {case[0] for case in CASES}


def test_throttle_is_measured_from_hover(step):
    assert terms.paper_throttle(step())[0, 0].item() == pytest.approx(1)
    assert step().state.throttle[0, 0, 0].item() == pytest.approx(dynamics.hover_throttle(step().drone))
