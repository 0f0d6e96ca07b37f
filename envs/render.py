"""Pictures and films of an episode: PNG, GIF (Pillow) and MP4 (the ``video`` extra), rendered offscreen by MuJoCo.

This process never loads OpenGL. It hands a :class:`Recording` to ``envs.render_worker``, a process of its own whose
``MUJOCO_GL`` is set before MuJoCo is imported there: EGL if it works, else OSMesa, or what the caller's own says.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from envs.formation import FormationEnv
from envs.obstacles import balls_at
from envs.render_worker import NO_OPENGL
from envs.scenarios import select
from envs.spec import FAR, Scenarios, State

Progress = Callable[[int, int], None]
"""Called with the number of frames done and their total."""


class RenderError(RuntimeError):
    """This machine cannot render; one line that says why and what to install."""


@dataclass(frozen=True)
class Recording:
    """One episode as arrays: all that a picture needs."""

    position: np.ndarray  # (T, N, 3) m
    attitude: np.ndarray  # (T, N, 4) wxyz
    balls: np.ndarray  # (T, M, 3) m, NaN before the throw
    columns: np.ndarray  # (C, 2) m
    hit: np.ndarray  # (T, N) whether the drone has hit something or crashed so far
    dt: float  # s between entries
    column_radius: float  # m
    ball_radius: float  # m


@dataclass(frozen=True)
class View:
    """Size and speed of the picture, and the camera, which follows the formation's centre."""

    width: int = 960  # pixels
    height: int = 540  # pixels
    fps: int = 25  # frames per second of film
    speed: float = 1.0  # seconds of flight per second of film
    azimuth: float = 70.0  # degrees, heading of the camera's gaze from world x towards y (the course is 90)
    elevation: float = -24.0  # degrees, negative looks down
    distance: float = 5.8  # m from the point looked at
    fovy: float = 45.0  # degrees, vertical field of view; small and far away draws to scale
    ahead: float = 1.2  # m along the course from the formation's centre to the point looked at
    trail: float = 2.0  # s of past flight drawn behind every drone
    drone_scale: float = 3.0  # drawn size of a drone over its true size of 12 cm


VIEWS = {
    "chase": View(),
    "above": View(azimuth=180.0, elevation=-90.0, distance=50.0, fovy=7.0, ahead=2.0),
    "side": View(azimuth=180.0, elevation=-12.0, distance=6.0, ahead=0.0),
}
"""Cameras by name."""


def record(
    env: FormationEnv,
    act: Callable[[State, Scenarios], Tensor],
    scenarios: Scenarios,
    episode: int = 0,
    seconds: float = 18.0,
) -> Recording:
    """Fly one episode of ``scenarios`` with ``act(state, scenarios) -> (1, N, 4)`` and record it."""
    chosen = select(scenarios, slice(episode, episode + 1))
    scenario = env.world.scenario
    state = env.reset(chosen)
    hit = torch.zeros(env.drones, dtype=torch.bool, device=state.position.device)
    entries = [(state.position[0], state.attitude[0], _balls(env, state), hit)]
    with torch.no_grad():
        for _ in range(round(seconds / env.dt)):
            state, _, events = env.step(state, act(state, chosen), chosen)
            nearest = torch.stack((events.column, events.ball, events.drone)).amin(0)[0]
            ground, ceiling = env.crashed(state)
            hit = hit | (nearest < scenario.hit_radius) | ground[0] | ceiling[0]
            entries.append((state.position[0], state.attitude[0], _balls(env, state), hit))
    position, attitude, balls, hits = (torch.stack(column).cpu().numpy() for column in zip(*entries, strict=True))
    columns = chosen.columns[0].cpu().numpy()
    return Recording(
        position=position,
        attitude=attitude,
        balls=balls,
        columns=columns[columns[:, 0] < FAR / 2],
        hit=hits,
        dt=env.dt,
        column_radius=scenario.column_radius,
        ball_radius=scenario.ball_radius,
    )


def render(
    recording: Recording,
    out: str | Path,
    view: View = VIEWS["chase"],
    moment: float | None = None,
    progress: Progress | None = None,
) -> Path:
    """Render to ``out``: .gif or .mp4 for the film, .png for the picture at ``moment`` seconds (default: half-way).

    ValueError for another ending, for a moment outside the episode and for MP4 without the ``video`` extra; RenderError
    where there is no offscreen OpenGL; OSError where ``out`` cannot be written. ``out`` appears when it is complete.
    """
    out = Path(out)
    frames = _frames(recording, out, view, moment)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".render-", dir=out.parent) as name:
        folder = Path(name)
        np.savez(folder / "recording.npz", **vars(recording))
        film = f"film{out.suffix}"
        job = {"view": asdict(view), "frames": frames, "out": film}
        (folder / "job.json").write_text(json.dumps(job))
        _first_backend([str(folder.resolve())], progress)
        (folder / film).replace(out)
    return out


def available() -> str:
    """The OpenGL backend that renders here, "default" where MuJoCo chooses; RenderError where there is none."""
    return _first_backend([], None)


def _balls(env: FormationEnv, state: State) -> Tensor:
    """Positions (M, 3) in m of one episode's balls, NaN before the throw."""
    position, _, _ = balls_at(state, env.time(state))
    return torch.where(state.ball_time[0, :, None].isinf(), torch.nan, position[0])


def _frames(recording: Recording, out: Path, view: View, moment: float | None) -> list[int]:
    """Entries of the recording that become frames of ``out``."""
    last = len(recording.position) - 1
    if out.suffix == ".png":
        entry = last // 2 if moment is None else round(moment / recording.dt)
        if not 0 <= entry <= last:
            raise ValueError(f"there is no picture at {moment} s: the episode lasts {last * recording.dt:g} s")
        return [entry]
    if out.suffix not in (".gif", ".mp4"):
        raise ValueError(f"cannot render to '{out.name}': the file has to end in .png, .gif or .mp4")
    if out.suffix == ".mp4" and find_spec("imageio_ffmpeg") is None:
        raise ValueError("MP4 needs the 'video' extra: pip install 'formctl[video]', or render to a .gif")
    stride = view.speed / view.fps / recording.dt
    return [round(k * stride) for k in range(int(last / stride) + 1)]


def _first_backend(arguments: list[str], progress: Progress | None) -> str:
    """Run the worker with the first backend that works here, and name it."""
    chosen = os.environ.get("MUJOCO_GL")
    backends = [chosen] if chosen else ["egl", "osmesa"] if sys.platform == "linux" else ["default"]
    reasons = []
    for backend in backends:
        reason = _run(arguments, backend, progress)
        if reason is None:
            return backend
        reasons.append(f"{backend}: {reason}")
    raise RenderError(
        f"no offscreen OpenGL here ({'; '.join(reasons)}): install libegl1 and libgl1-mesa-dri, or libosmesa6"
    )


def _run(arguments: list[str], backend: str, progress: Progress | None) -> str | None:
    """Run the worker; None when it is done, else why this backend does not work. RenderError if it failed later."""
    root = str(Path(__file__).resolve().parent.parent)
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    if backend != "default":
        environment["MUJOCO_GL"] = backend
    command = [sys.executable, "-m", "envs.render_worker", *arguments]
    with (
        tempfile.TemporaryFile("w+") as complaints,
        subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=complaints, text=True) as worker,
    ):
        assert worker.stdout is not None
        for line in worker.stdout:
            if progress is not None:
                done, total = line.split()
                progress(int(done), int(total))
        code = worker.wait()
        complaints.seek(0)
        last = (complaints.read().strip().splitlines() or ["no message"])[-1]
    if code not in (0, NO_OPENGL):
        raise RenderError(f"rendering failed: {last}")
    return last if code else None
