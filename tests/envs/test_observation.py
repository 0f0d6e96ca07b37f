"""What drones see: widths, masks, conditioning and signs."""

import pytest
import torch

from envs import observation, obstacles, scenarios
from tests.envs.test_dynamics import command


def seen(env, state, drawn):
    return env.observe(state, drawn)


def flown(env, steps=5, episodes=3):
    drawn = scenarios.sample(env.world.scenario, episodes, 0, dtype=env.dtype)
    state = env.reset(drawn)
    for _ in range(steps):
        state, _, _ = env.step(state, command(env, episodes, roll=-0.2, thrust=0.1), drawn)
    return state, drawn


@pytest.mark.parametrize(
    ("choice", "width"),
    [("paper", 25), ("paper_raw", 25), ("release", 29), ("paper observation.previous_command=true", 29)],
)
@pytest.mark.parametrize("formation", ["triangle", "hexagon", "[[0,0,0],[1,0,0]]"])
def test_widths_follow_the_choice_and_the_number_of_drones(make_env, choice, width, formation):
    name, *more = choice.split()
    env = make_env("scenario=mixed", f"observation={name}", f"scenario.formation={formation}", *more)
    state, drawn = flown(env, steps=1)
    groups = seen(env, state, drawn)
    drones = env.drones
    shapes = {name: tuple(x.shape) for name, x in groups.items()}
    assert shapes == {
        "self": (3, drones, 1, width),
        "drones": (3, drones, drones - 1, 7),
        "static": (3, drones, 1, 9),
        "dynamic": (3, drones, 2, 10),
        "static_mask": (3, drones, 1),
        "dynamic_mask": (3, drones, 2),
    }
    assert env.layout == observation.ObservationLayout(name, drones, width, 7, 9, 10)


def test_raw_self_group_is_the_papers_list(make_env):
    env = make_env("scenario=mixed", "observation=paper_raw")
    state, drawn = flown(env)
    own = seen(env, state, drawn)["self"][:, :, 0]
    wanted = torch.tensor([0.0, 2.0, 0.0], dtype=env.dtype)
    torch.testing.assert_close(own[..., :3], state.position)
    torch.testing.assert_close(own[..., 3:7], state.attitude)
    torch.testing.assert_close(own[..., 7:10], state.velocity)
    torch.testing.assert_close(own[..., 10:13], state.rates)
    torch.testing.assert_close(own[..., 19:22], wanted - state.velocity)
    assert own[0, :, 22:].tolist() == [[0, 0, 0], [1, 1, 1], [2, 2, 2]]


def test_conditioning_can_be_undone(make_env):
    env = make_env("scenario=mixed")
    raw = make_env("scenario=mixed", "observation=paper_raw")
    state, drawn = flown(env)
    state = state._replace(position=state.position + torch.tensor([0.1, 3.0, 0.0], dtype=env.dtype))
    ours, theirs = seen(env, state, drawn), seen(raw, state, drawn)
    own = ours["self"][:, :, 0]
    scheduled = 2.0 * env.time(state)[:, None]
    undone = torch.stack((own[..., 0], 5 * own[..., 1] + scheduled, own[..., 2] + 1.5), -1)
    torch.testing.assert_close(undone, theirs["self"][:, :, 0, :3])
    static = ours["static"]
    centre = theirs["static"][..., 4:5]
    faded = torch.exp(-0.3 * centre.clamp_max(9.0))
    others = [0, 1, 2, 3, 5, 6, 7, 8]
    torch.testing.assert_close(static[..., others] / faded / 8 + centre, theirs["static"][..., others])


def test_others_are_own_minus_other_in_ascending_order(make_env):
    env = make_env("scenario=free", "observation=paper_raw")
    state, drawn = flown(env)
    group = seen(env, state, drawn)["drones"]
    torch.testing.assert_close(group[:, 1, 0, :3], (state.position[:, 1] - state.position[:, 0]) / 2)
    torch.testing.assert_close(group[:, 1, 1, :3], (state.position[:, 1] - state.position[:, 2]) / 2)
    torch.testing.assert_close(group[:, 2, 0, 4:], state.velocity[:, 2] - state.velocity[:, 0])


def test_relative_to_slots_what_is_left_of_the_others_is_the_error_of_the_formation(make_env):
    raw, env = make_env("scenario=free", "observation=paper_raw"), make_env("scenario=free")
    state, drawn = flown(env)
    assert seen(env, env.reset(drawn), drawn)["drones"][..., :3].abs().max() < 1e-7  # starts have float32's precision
    theirs, ours = seen(raw, state, drawn)["drones"], seen(env, state, drawn)["drones"]
    others = torch.tensor([[1, 2], [0, 2], [0, 1]])
    torch.testing.assert_close(ours[..., :3] + env.slots[:, None] - env.slots[others], 2 * theirs[..., :3])
    torch.testing.assert_close(ours[..., 3:], theirs[..., 3:])


def test_column_distances_are_to_the_nearest_axis_from_a_world_aligned_grid(make_env):
    env = make_env("scenario=static", "observation=paper_raw")
    state, drawn = flown(env)
    group = seen(env, state, drawn)["static"][0, 1, 0]
    here = state.position[0, 1, :2]
    for number, (dx, dy) in enumerate((x, y) for x in (-0.1, 0.0, 0.1) for y in (-0.1, 0.0, 0.1)):
        point = here + torch.tensor([dx, dy], dtype=env.dtype)
        expected = (drawn.columns[0] - point).norm(dim=-1).min()
        torch.testing.assert_close(group[number], expected)


def test_balls_are_seen_while_airborne_near_and_above_the_ground(make_env):
    env = make_env("scenario=dynamic", "scenario.balls=3", "observation=paper_raw")
    drawn = scenarios.sample(env.world.scenario, 1, 0, dtype=env.dtype)
    state = env.reset(drawn)
    place = torch.tensor([[[1.0, 2.0, 1.5], [30.0, 0.0, 1.5], [1.0, 1.0, 0.18]]], dtype=env.dtype)
    state = state._replace(
        ball_origin=place,
        ball_velocity=torch.zeros_like(place),
        ball_time=torch.zeros(1, 3, dtype=env.dtype),
        ball_landing=torch.ones(1, 3, dtype=env.dtype),
    )
    group = seen(env, state, drawn)
    assert group["dynamic_mask"][0, 0].tolist() == [True, False, False]
    token = group["dynamic"][0, 0, 0]
    offset = place[0, 0] - state.position[0, 0]
    torch.testing.assert_close(token[:4], torch.cat((offset.norm()[None], offset)))
    assert group["dynamic"][0, 0, 1:].abs().max() == 0


@pytest.mark.parametrize("lookahead", ["2.0", "0.0"])
def test_a_balls_place_follows_from_what_is_seen(make_env, lookahead):
    env = make_env("scenario=dynamic", "scenario.balls=4", f"observation.lookahead={lookahead}")
    raw = make_env("scenario=dynamic", "scenario.balls=4", "observation=paper_raw")
    state, drawn = thrown(env)
    ours, theirs = seen(env, state, drawn)["dynamic"], seen(raw, state, drawn)["dynamic"]
    assert seen(env, state, drawn)["dynamic_mask"].any()
    place, relative = theirs[..., 1:4], theirs[..., 4:7]
    torch.testing.assert_close(ours[..., 4:] / 0.3, theirs[..., 4:])
    if lookahead == "0.0":
        torch.testing.assert_close(ours[..., 1:4] / 0.3, place)
        return
    time, squashed = ours[..., :1], ours[..., 1:4]
    miss = 0.5 * squashed / (1 - squashed.norm(dim=-1, keepdim=True))
    fall = torch.tensor([0.0, 0.0, 0.5 * 9.81], dtype=env.dtype) * time.square()
    torch.testing.assert_close(miss - relative * time + fall, place, atol=1e-6, rtol=1e-6)


def test_the_closest_pass_is_where_the_ball_will_be(make_env):
    """A ball flown on with a drone that keeps its velocity is nearest, over ground, at the time that was shown."""
    env = make_env("scenario=dynamic", "scenario.balls=4")
    state, drawn = thrown(env)
    time = seen(env, state, drawn)["dynamic"][0, 0, :, 0]
    mask = seen(env, state, drawn)["dynamic_mask"][0, 0]
    aloft = state._replace(ball_landing=torch.full_like(state.ball_landing, 99))
    ahead = torch.linspace(0, 2, 401, dtype=env.dtype)
    for ball in mask.nonzero().flatten().tolist():
        gaps = []
        for t in ahead:
            centre, _, _ = obstacles.balls_at(aloft, env.time(state) + t)
            drone = state.position[0, 0] + state.velocity[0, 0] * t
            gaps.append((centre[0, ball] - drone)[:2].norm())
        nearest = ahead[torch.stack(gaps).argmin()].item()
        assert nearest == pytest.approx(time[ball].item(), rel=0.2, abs=0.05)  # slow passes are shown a little early


def thrown(env):
    """One episode, in steady flight, at a time when balls are in the air."""
    drawn = scenarios.sample(env.world.scenario, 1, 3, dtype=env.dtype)
    drawn = drawn._replace(throw_time=torch.full_like(drawn.throw_time, 0.1))
    state = env.reset(drawn)
    state = state._replace(velocity=state.velocity + torch.tensor([0.0, 2.0, 0.0], dtype=env.dtype))
    for _ in range(15):
        state, _, _ = env.step(state, state.command, drawn)
    return state, drawn
