"""A recording as one HTML file: a double click shows it, without a network, in any browser.

Everything is inside: the numbers as JSON, three.js (``viewer/vendor``) and the viewer's own modules as ``data:``
addresses of an import map. Without WebGL the page draws the flight from above on a plain canvas.
"""

import base64
import html
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from analysis.data.text import counted
from analysis.recordings.record import Array, Event, Recording, Scene, Trace

VIEWER = Path(__file__).parent / "viewer"
MODULES = {
    "three": "vendor/three.module.min.js",
    "three/orbit": "vendor/OrbitControls.js",
    "formctl/flight": "flight.js",
    "formctl/view2d": "view2d.js",
    "formctl/view3d": "view3d.js",
    "formctl/player": "player.js",
}
PERIOD = 0.04
"""s between the samples that a page keeps; it draws what lies between them."""

MET = {
    "column": "hit a column",
    "ball": "was hit by a ball",
    "drone": "two drones met",
    "ground": "fell to the ground",
    "ceiling": "rose above the ceiling",
    "corridor": "left the flight corridor",
    "late": "did not reach the goal in time",
}


def render(recording: Recording) -> str:
    """The page's text."""
    title = f"{' and '.join(trace.method for trace in recording.traces)}, {recording.scene.scenario}"
    data = json.dumps(content(recording), separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
    parts = {
        "@TITLE@": html.escape(title),
        "@STYLE@": (VIEWER / "style.css").read_text(encoding="utf-8"),
        "@MODULES@": json.dumps({"imports": {name: _address(VIEWER / path) for name, path in MODULES.items()}}),
        "@DATA@": data,
    }
    page = (VIEWER / "index.html").read_text(encoding="utf-8")
    for mark, text in parts.items():
        page = page.replace(mark, text)
    return page


def content(recording: Recording) -> dict[str, Any]:
    """What the page is told: lengths in m and times in s, positions and attitudes as integers in thousandths."""
    scene = recording.scene
    stride = max(1, round(PERIOD / scene.period))
    return {
        "scene": {
            "name": scene.scenario,
            "episode": scene.episode,
            "words": _words(scene, recording.traces[0]),
            "columns": np.round(scene.columns, 3).tolist(),
            "goal": scene.goal,
            "column_radius": scene.column_radius,
            "ball_radius": scene.ball_radius,
            "period": round(stride * scene.period, 9),
        },
        "methods": [_method(trace, stride) for trace in recording.traces],
        "provenance": recording.provenance,
    }


def _method(trace: Trace, stride: int) -> dict[str, Any]:
    obstacles = trace.gap[..., :2].min(-1).min(-1) if trace.gap.size else np.zeros(0)
    return {
        "name": trace.method,
        "verdict": verdict(trace.row),
        "success": bool(trace.row["cfr"]),
        "drones": trace.position.shape[1],
        "position": _thousandths(trace.position[::stride]),
        "attitude": _thousandths(trace.attitude[::stride]),
        "error": _series(trace.formation_error, stride),
        "nearest": _series(obstacles, stride),
        "speed": np.round(np.linalg.norm(trace.velocity, axis=-1).mean(-1)[::stride], 2).tolist(),
        "throws": [
            {
                "ball": throw.ball,
                "time": round(throw.time, 3),
                "landing": round(throw.landing, 3),
                "origin": np.round(throw.origin, 3).tolist(),
                "velocity": np.round(throw.velocity, 3).tolist(),
            }
            for throw in trace.throws
        ],
        "events": [_event(event) for event in trace.events],
        "plans": [
            {"time": round(plan.time, 3), "drone": plan.drone, "points": np.round(plan.points, 3).tolist()}
            for plan in trace.plans
        ],
    }


def verdict(row: Mapping[str, Any]) -> str:
    """How an episode ended, in a few words."""
    fm = f"FM {row['fm']:.2f} m" if row.get("fm") is not None else "no FM"
    if row["cfr"]:
        return f"collision-free, at the goal after {row['time_to_goal']:.1f} s, {fm}"
    failure = str(row["failure"])
    when = row.get("first_contact_time")
    after = f" after {when:.1f} s" if failure != "late" and when is not None else ""
    return f"{MET.get(failure, failure)}{after}, {fm}"


def _words(scene: Scene, trace: Trace) -> str:
    met = f"{counted(len(scene.columns), 'column')}, {counted(trace.ball.shape[1], 'ball')}"
    return f"episode {scene.episode}: {met}, {counted(trace.position.shape[1], 'drone')}"


def _event(event: Event) -> dict[str, Any]:
    return {"time": round(event.time, 3), "kind": event.kind, "text": event.text, "drone": event.drone}


def _thousandths(values: Array) -> list[int]:
    finite = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
    return [int(value) for value in np.rint(1000 * finite).reshape(-1)]


def _series(values: Array, stride: int) -> list[float | None]:
    """A number for every kept sample: the step's that led to it, the first step's at the start."""
    samples = np.concatenate((values[:1], values))[::stride]
    return [round(float(value), 3) if np.isfinite(value) else None for value in samples]


def _address(path: Path) -> str:
    return "data:text/javascript;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
