"""Pictures and films: what is in them, and what is said where they cannot be made."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from PIL import Image

from envs import render as rendering
from envs.render import VIEWS, Recording, RenderError, View, available, record, render
from envs.scenarios import sample

SMALL = View(width=320, height=180, fps=10, trail=0.5)


def opengl() -> bool:
    """Whether this machine renders."""
    try:
        available()
    except RenderError:
        return False
    return True


needs_opengl = pytest.mark.skipif(not opengl(), reason="neither EGL nor OSMesa here")


@pytest.fixture(scope="module")
def recording():
    """Three drones in formation, flying 2 s along the course past one column, and one ball beside them."""
    entries = 101
    slots = np.array([[1.0, 0.0, 1.5], [-0.5, 0.866, 1.5], [-0.5, -0.866, 1.5]])
    way = 2 * 0.02 * np.arange(entries)[:, None, None] * np.array([0.0, 1.0, 0.0])
    ball = np.full((entries, 1, 3), np.nan)
    ball[50:] = [0.2, 2.5, 1.8]
    return Recording(
        position=slots + way,
        attitude=np.tile([1.0, 0.0, 0.0, 0.0], (entries, 3, 1)),
        balls=ball,
        columns=np.array([[1.5, 4.0]]),
        hit=np.zeros((entries, 3), dtype=bool),
        dt=0.02,
        column_radius=0.15,
        ball_radius=0.15,
    )


def picture(recording, path, **choice):
    """The rendered picture as (height, width, 3) float."""
    with Image.open(render(recording, path, **choice)) as image:
        return np.asarray(image.convert("RGB"), dtype=float)


def red_and_orange(image):
    """Number of pixels that are red (a hit drone), and orange (a ball)."""
    red, green, blue = image[..., 0], image[..., 1], image[..., 2]
    return int(((red > 120) & (green < 70) & (blue < 70)).sum()), int(((red > 180) & (green > 70) & (blue < 60)).sum())


@needs_opengl
def test_picture_shows_ball_and_hit_only_when_they_are_there(recording, tmp_path):
    view = View(width=320, height=180, trail=0.0)
    before = picture(recording, tmp_path / "before.png", view=view, moment=0.9)
    assert before.shape == (180, 320, 3)
    thrown = picture(recording, tmp_path / "thrown.png", view=view, moment=1.1)
    hit = picture(
        Recording(**{**vars(recording), "hit": recording.hit | True}), tmp_path / "hit.png", view=view, moment=0.9
    )
    assert red_and_orange(before)[0] == 0
    assert red_and_orange(thrown)[1] > red_and_orange(before)[1] + 30
    assert red_and_orange(hit)[0] > 30


@needs_opengl
@pytest.mark.parametrize("name", sorted(VIEWS))
def test_cameras_follow_the_formation(recording, tmp_path, name):
    """Four metres on, the drones' blue and green are still in the picture."""
    image = picture(recording, tmp_path / "view.png", view=VIEWS[name], moment=2.0)
    red, green, blue = image[..., 0], image[..., 1], image[..., 2]
    assert ((blue > red + 60) & (blue > 90)).sum() > 20
    assert ((green > red + 50) & (green > blue + 20)).sum() > 20


@needs_opengl
def test_gif_has_every_frame_and_reports_progress(recording, tmp_path):
    steps = []
    path = render(recording, tmp_path / "new" / "film.gif", SMALL, progress=lambda *step: steps.append(step))
    with Image.open(path) as film:
        assert film.n_frames == 21
        assert film.info["duration"] == 100
        assert film.size == (320, 180)
        first = np.asarray(film.convert("RGB"), dtype=float)
        film.seek(20)
        assert np.abs(np.asarray(film.convert("RGB"), dtype=float) - first).mean() > 1
    assert steps == [(k, 21) for k in range(1, 22)]
    assert [entry.name for entry in path.parent.iterdir()] == ["film.gif"]


@needs_opengl
def test_mp4_plays(recording, tmp_path):
    reader = pytest.importorskip("imageio.v2")
    path = render(recording, tmp_path / "film.mp4", View(width=320, height=180, fps=10, speed=2.0))
    with reader.get_reader(path) as film:
        assert film.count_frames() == 11
        assert film.get_meta_data()["fps"] == 10


def test_record_follows_the_episode(make_env):
    """A drone that starts inside a column is hit at once; absent columns and unthrown balls are not drawn."""
    env = make_env("scenario=mixed", "scenario.balls=1", "scenario.columns=1", "scenario.throw_time=[0.1,0.1]")
    scenarios = sample(env.world.scenario, 2, 0, torch.float64)
    scenarios.columns[1, 0] = scenarios.position[1, 2, :2]
    hover = env.reset(scenarios).command[:1]
    taken = record(env, lambda state, _: hover, scenarios, episode=1, seconds=0.4)
    assert taken.position.shape == (21, 3, 3)
    assert taken.hit[0].tolist() == [False, False, False]
    assert taken.hit[1:].all(0).tolist() == [False, False, True]
    assert np.isnan(taken.balls[:5]).all()
    assert np.isfinite(taken.balls[7:]).all()
    assert taken.columns.tolist() == scenarios.columns[1].tolist()
    scenarios.columns[1] = 1e3
    assert record(env, lambda state, _: hover, scenarios, episode=1, seconds=0.1).columns.shape == (0, 2)


@pytest.mark.parametrize(
    ("name", "moment", "message"),
    [
        ("film.avi", None, "cannot render to 'film.avi': the file has to end in .png, .gif or .mp4"),
        ("picture.png", 3.0, "there is no picture at 3.0 s: the episode lasts 2 s"),
        ("picture.png", -1.0, "there is no picture at -1.0 s"),
    ],
)
def test_calls_that_make_no_sense(recording, tmp_path, name, moment, message):
    with pytest.raises(ValueError, match=message):
        render(recording, tmp_path / name, moment=moment)
    assert list(tmp_path.iterdir()) == []


def test_mp4_without_the_extra_names_it(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(rendering, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'formctl\[video\]', or render to a .gif"):
        render(recording, tmp_path / "film.mp4")


def test_without_opengl_one_line_says_what_to_install(recording, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "glx")
    monkeypatch.setenv("DISPLAY", ":nowhere")
    with pytest.raises(RenderError, match="install libegl1 and libgl1-mesa-dri, or libosmesa6") as caught:
        render(recording, tmp_path / "picture.png")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_importing_the_module_loads_no_opengl():
    code = (
        "import sys, envs.render; print([name for name in ('mujoco', 'OpenGL', 'glfw', 'PIL') if name in sys.modules])"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
