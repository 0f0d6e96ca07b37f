"""An episode from above: columns, trails in time order, the formation at every other second, balls and their arcs.

Input is plain arrays, so any recording can be drawn. Flight is along +y, which runs to the right on paper; the course
is wrapped like text, since 36 m in one line would leave the drones smaller than a full stop.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from analysis.figures import style

BEAT = 2.0  # s between drawn formations
SAMPLE = 0.1  # s between the samples of a trail: a turn at 5 m/s² is drawn to 6 mm, a tenth of a point in print
STROKE = 2  # such samples in one shade: the next shade cannot be told from it


@dataclass(frozen=True)
class DrawnFlight:
    """One recorded episode in world coordinates (m, s); T samples, N drones, C columns, M balls."""

    times: NDArray[np.float64]  # (T,)
    positions: NDArray[np.float64]  # (T, N, 3)
    columns: NDArray[np.float64]  # (C, 2) axes
    balls: NDArray[np.float64]  # (T, M, 3), NaN while a ball is not in flight
    hits: Sequence[tuple[float, int, str]] = field(default=())  # time, drone, what was hit
    goal: float | None = 34.0  # m, y of the goal line
    column_radius: float = 0.15  # m
    ball_radius: float = 0.15  # m

    def __post_init__(self) -> None:
        steps, drones = self.positions.shape[:2] if self.positions.ndim == 3 else (0, 0)
        fits = self.times.shape == (steps,) and self.balls.ndim == 3 and self.balls.shape[0] == steps
        if not (fits and steps > 1 and drones > 0 and self.positions.shape[2] == self.balls.shape[2] == 3):
            raise ValueError(
                "a flight needs times (T,), positions (T, N, 3) and balls (T, M, 3) with T > 1, got "
                f"{self.times.shape}, {self.positions.shape} and {self.balls.shape}"
            )


def draw_topview(
    flight: DrawnFlight, title: str = "", stamp: str = "", lines: int = 2, span: tuple[float, float] | None = None
) -> Figure:
    """The flight seen from above, two columns wide. lines: rows the course is wrapped into; span: y from, to (m)."""
    start, stop = span or whole_span(flight)
    half = half_width(flight)
    length = (stop - start) / lines
    scale = (style.DOUBLE - 0.55) / (length * 1.04)  # inches per metre
    with style.styled():
        figure = style.new(style.DOUBLE, lines * (2 * half * scale + 0.28) + 0.75)
        panels = np.atleast_1d(figure.subplots(lines, 1))
        for number, axes in enumerate(panels):
            low = start + number * length
            panel(axes, flight, (low, low + length), half)
        panels[-1].set_xlabel("Course y (m)")
        figure.supylabel("Lateral x (m)", fontsize=8.5)
        handles = legend(flight)
        figure.legend(
            handles=handles, loc="outside upper right", ncols=len(handles), columnspacing=1.1, handletextpad=0.5
        )
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=8.5)
        if stamp:
            style.put_stamp(figure, stamp)
        return style.settle(figure)


def flight_data(flight: DrawnFlight) -> pd.DataFrame:
    """The drawn trails as a tidy frame: time, body (drone 0, ball 0, ...), x, y, z; balls only while they fly.

    As many samples as are drawn, to the millimetre and millisecond.
    """
    kept = samples(flight.times)
    frames = []
    for name, tracks in (("drone", flight.positions), ("ball", flight.balls)):
        for number in range(tracks.shape[1]):
            frame = pd.DataFrame(tracks[kept, number], columns=["x", "y", "z"])
            frame.insert(0, "time", flight.times[kept])
            frame.insert(1, "body", f"{name} {number}")
            frames.append(frame.dropna())
    return pd.concat(frames, ignore_index=True).round(3)


def panel(axes: Axes, flight: DrawnFlight, span: tuple[float, float], half: float) -> None:
    """One line of the wrapped course."""
    axes.set_aspect("equal")
    margin = 0.02 * (span[1] - span[0])
    axes.set_xlim(span[0] - margin, span[1] + margin)
    axes.set_ylim(half, -half)  # x grows to the right of the flight, which is downwards on paper
    axes.set_yticks([-2, 0, 2])
    axes.xaxis.set_major_locator(MultipleLocator(2))
    axes.grid(visible=True, lw=0.4)
    if flight.goal is not None and span[0] - margin <= flight.goal <= span[1] + margin:
        axes.axvline(flight.goal, color=style.INK, lw=0.9, ls=(0, (1, 1.2)), zorder=1)
        axes.text(flight.goal, -half, " goal", fontsize=6.5, va="bottom", ha="center")
    for x, y in flight.columns:
        axes.add_patch(Circle((y, x), flight.column_radius, fc=style.COLUMN_FILL, ec="none", zorder=2))
    for ball in range(flight.balls.shape[1]):
        _ball(axes, flight, ball)
    for drone in range(flight.positions.shape[1]):
        _trail(axes, flight, drone)
    _formations(axes, flight, span)
    for time, drone, _ in flight.hits:
        x, y = flight.positions[nearest(flight, time), drone, :2]
        axes.plot(y, x, marker="x", ms=7, mew=1.6, color=style.INK, zorder=7)


def _trail(axes: Axes, flight: DrawnFlight, drone: int) -> None:
    """A drone's path, pale at the start of the episode and full at its end."""
    low, high = axes.get_xlim()
    path = flight.positions[samples(flight.times), drone, 1::-1]  # as y, x
    pieces, colors = strokes(path, style.DRONES[drone % len(style.DRONES)], 0.4)
    seen = [n for n, piece in enumerate(pieces) if low <= piece[:, 0].max() and piece[:, 0].min() <= high]
    trail = LineCollection(
        [pieces[n] for n in seen], colors=colors[seen], linewidths=1.2, capstyle="round", joinstyle="round", zorder=3
    )
    axes.add_collection(trail, autolim=False)


def _formations(axes: Axes, flight: DrawnFlight, span: tuple[float, float]) -> None:
    """The formation as a polygon at every beat, with the drones as dots and the time above."""
    for time in np.arange(flight.times[0], flight.times[-1] + 1e-9, BEAT):
        at = flight.positions[nearest(flight, float(time))]
        corners = at[:, 1::-1] if len(at) < 3 else at[around(at[:, :2]), 1::-1]
        outline = np.vstack([corners, corners[:1]])
        axes.plot(*outline.T, color=style.FAINT, lw=0.6, zorder=4)
        for drone, (x, y, _) in enumerate(at):
            axes.plot(y, x, "o", ms=3.6, mfc=style.DRONES[drone % len(style.DRONES)], mec="white", mew=0.5, zorder=6)
        middle = at[:, 1].mean()
        if span[0] - 0.1 <= middle <= span[1]:
            place = axes.get_ylim()[0] - 0.1
            label = axes.text(
                middle, place, f"{time:g} s", fontsize=6, color=style.FAINT, ha="center", va="bottom", zorder=6
            )
            label.set_bbox({"fc": "white", "ec": "none", "pad": 0.6})


def _ball(axes: Axes, flight: DrawnFlight, ball: int) -> None:
    """A ball's arc with its direction, and the ball itself where it came closest to a drone."""
    arc = flight.balls[:, ball]
    flying = np.isfinite(arc[:, 0])
    if not flying.any():
        return
    axes.plot(arc[flying, 1], arc[flying, 0], color=style.BALL, lw=0.8, ls=(0, (3, 1.5)), alpha=0.75, zorder=2.5)
    gaps = np.linalg.norm(flight.positions - arc[:, None], axis=2)  # (T, N)
    closest, drone = np.unravel_index(int(np.nanargmin(np.where(flying[:, None], gaps, np.nan))), gaps.shape)
    x, y, z = arc[closest]
    axes.add_patch(Circle((y, x), flight.ball_radius, fc=style.BALL, ec="white", lw=0.4, alpha=0.9, zorder=5))
    above = f"{z - flight.positions[closest, drone, 2]:+.1f} m".replace("-", "−")
    label = axes.annotate(above, (y, x), (0, -4.5), textcoords="offset points", ha="center", va="top", fontsize=5.5)
    label.set(color=style.BALL, zorder=8, annotation_clip=True)
    label.set_path_effects([withStroke(linewidth=1.6, foreground="white")])
    last = int(np.flatnonzero(flying)[-1])
    before = max(int(np.flatnonzero(flying)[0]), last - 3)
    if last > before:
        tip, tail = ((float(arc[at, 1]), float(arc[at, 0])) for at in (last, before))
        axes.annotate(
            "",
            tip,
            tail,
            arrowprops={"arrowstyle": "-|>", "color": style.BALL, "lw": 0.6, "mutation_scale": 6},
            annotation_clip=True,
        )


def legend(flight: DrawnFlight) -> list[Line2D]:
    handles = [
        Line2D(
            [],
            [],
            color=style.DRONES[n % len(style.DRONES)],
            marker="o",
            ms=4,
            mec="white",
            mew=0.5,
            label=f"drone {n}",
        )
        for n in range(flight.positions.shape[1])
    ]
    if len(flight.columns):
        handles.append(Line2D([], [], ls="", marker="o", ms=4.5, color=style.COLUMN_FILL, label="column"))
    if np.isfinite(flight.balls).any():
        handles.append(
            Line2D(
                [],
                [],
                ls=(0, (3, 1.5)),
                lw=0.8,
                marker="o",
                ms=4.5,
                color=style.BALL,
                label="ball where closest, and its height over the drone",
            )
        )
    if flight.hits:
        handles.append(Line2D([], [], ls="", marker="x", ms=6, mew=1.6, color=style.INK, label="hit"))
    return handles


def samples(times: NDArray[np.float64]) -> NDArray[np.intp]:
    """Which of a flight's samples (T,) trails are drawn from and listed with: about SAMPLE apart, and the last one."""
    last = len(times) - 1
    beat = max(1, round(SAMPLE * last / (times[-1] - times[0])))
    return np.append(np.arange(0, last, beat), last)


def strokes(
    path: NDArray[np.float64], color: str, palest: float
) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
    """A path (T, d) in strokes of (STROKE + 1, d) at most, and their colours (S, 3): from ``palest`` to full."""
    pieces = [path[at : at + STROKE + 1] for at in range(0, len(path) - 1, STROKE)]
    share = np.linspace(palest, 1.0, len(pieces))[:, None]
    # Towards white, not transparent: overlapping ends would show as dots.
    return pieces, share * np.array(to_rgb(color)) + (1 - share)


def whole_span(flight: DrawnFlight) -> tuple[float, float]:
    """From the hindmost start to the goal, or as far as the drones got past it, up to 2 m."""
    course = flight.positions[..., 1]
    if flight.goal is None:
        return float(np.floor(course.min())), float(np.ceil(course.max()))
    stop = np.clip(course.max(), flight.goal, flight.goal + 2)
    return float(np.floor(course.min())), float(np.ceil(stop))


def half_width(flight: DrawnFlight) -> float:
    lateral = [np.abs(flight.positions[..., 0]).max(), *np.abs(flight.columns[:, 0])]
    return float(np.clip(max(lateral) + 0.35, 2.5, 6.0))


def around(points: NDArray[np.float64]) -> NDArray[np.intp]:
    """Order of points (N, 2) around their centre, so that the outline does not cross itself."""
    offset = points - points.mean(axis=0)
    return np.argsort(np.arctan2(offset[:, 1], offset[:, 0]), kind="stable")


def nearest(flight: DrawnFlight, time: float) -> int:
    return int(np.argmin(np.abs(flight.times - time)))
