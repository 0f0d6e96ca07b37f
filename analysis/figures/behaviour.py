"""How methods behave in one scene: each from above and in perspective, trails in the order of time (paper, Fig. 4)."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from numpy.typing import NDArray

from analysis.figures import style, topview
from analysis.figures.topview import DrawnFlight
from analysis.recordings import Recording, Trace

COLUMN_HEIGHT = 3.0
"""m, drawn (paper, Sec. III-A); the world's columns are infinite."""
SHOWN = 12.0
"""m of course at least."""
LONG = 18.0
"""m of course that two views side by side can show."""


def flight_of(recording: Recording, trace: Trace, until: float | None = None) -> DrawnFlight:
    """A trace as the top view draws it, up to its end or ``until`` s; balls only while they fly."""
    scene = recording.scene
    times = recording.times(trace)
    kept = times <= (np.inf if until is None else until)
    ball = trace.ball.copy()
    for throw in trace.throws:
        ball[times >= throw.landing, throw.ball] = np.nan
    contacts = [(event.time, event.drone, event.cause) for event in trace.events if event.kind == "contact"]
    return DrawnFlight(
        times=times[kept],
        positions=trace.position[kept],
        columns=scene.columns,
        balls=ball[kept],
        hits=[contact for contact in contacts if until is None or contact[0] <= until],
        goal=scene.goal,
        column_radius=scene.column_radius,
        ball_radius=scene.ball_radius,
    )


def draw_episode(recording: Recording) -> Figure:
    """One method: the whole course from above. Several: one below the other, from above and in perspective."""
    if len(recording.traces) > 1:
        return draw_behaviour(recording, whole=True)
    trace = recording.traces[0]
    return topview.draw_topview(flight_of(recording, trace), f"{trace.method}, scenario {recording.scene.scenario}")


def draw_behaviour(recording: Recording, stamp: str = "", names: Sequence[str] = (), whole: bool = False) -> Figure:
    """All methods of a recording around its obstacles, two columns wide: from above and, beside it, in perspective.

    At most LONG metres are shown; ``whole`` shows all of a longer course, from above only. ``names`` replaces the
    methods' own.
    """
    flights = [flight_of(recording, trace) for trace in recording.traces]
    start, stop = span(flights)
    alone = whole and stop - start > LONG
    start, stop = (start, stop) if alone else shown(flights)
    half = max(topview.half_width(flight) for flight in flights)
    with style.styled():
        height = style.DOUBLE * (0.92 if alone else 0.56) * 2 * half / (stop - start) + 0.45
        figure = style.new(style.DOUBLE, len(flights) * height + 0.55)
        grid = figure.add_gridspec(len(flights), 1 if alone else 2, width_ratios=(1,) if alone else (1.45, 1))
        for number, (flight, trace) in enumerate(zip(flights, recording.traces, strict=True)):
            axes = figure.add_subplot(grid[number, 0])
            topview.panel(axes, flight, (start, stop), half)
            axes.set_title(names[number] if names else trace.method, loc="left")
            axes.set_ylabel("x (m)")
            if number == len(flights) - 1:
                axes.set_xlabel("Course y (m)")
            if not alone:
                perspective(figure.add_subplot(grid[number, 1], projection="3d"), flight, (start, stop), half)
        handles = {str(h.get_label()): h for flight in flights for h in topview.legend(flight)}
        figure.legend(handles=list(handles.values()), loc="outside upper right", ncols=len(handles), columnspacing=1.1)
        if stamp:
            style.put_stamp(figure, stamp)
        return style.settle(figure)


def behaviour_data(recording: Recording, names: Sequence[str] = ()) -> pd.DataFrame:
    """The trails of ``draw_behaviour`` as a tidy frame: method, time, body, x, y, z, along the course that it shows."""
    flights = [flight_of(recording, trace) for trace in recording.traces]
    low, high = shown(flights)
    frames = []
    for number, (flight, trace) in enumerate(zip(flights, recording.traces, strict=True)):
        frame = topview.flight_data(flight)
        frame.insert(0, "method", names[number] if names else trace.method)
        frames.append(frame[frame["y"].between(low, high)])
    return pd.concat(frames, ignore_index=True)


def shown(flights: Sequence[DrawnFlight]) -> tuple[float, float]:
    """The course around the obstacles as far as two views side by side can show it."""
    start, stop = span(flights)
    return start, min(stop, start + LONG)


def span(flights: Sequence[DrawnFlight]) -> tuple[float, float]:
    """The course around the obstacles: columns, and the places where balls come closest."""
    met = [float(y) for _, y in flights[0].columns]
    for flight in flights:
        for ball in range(flight.balls.shape[1]):
            gap = np.linalg.norm(flight.positions - flight.balls[:, None, ball], axis=-1).min(-1)
            if np.isfinite(gap).any():
                met.append(float(flight.positions[int(np.nanargmin(gap)), :, 1].mean()))
    whole = topview.whole_span(flights[0])
    if not met:
        return whole
    low, high = max(min(met) - 4, whole[0]), min(max(met) + 4, whole[1])
    return low, max(high, min(low + SHOWN, whole[1]))


def perspective(axes: Axes3D, flight: DrawnFlight, span: tuple[float, float], half: float) -> None:
    """The same part of the course seen from behind and above; later is darker."""
    low, high = span
    for x, y in flight.columns:
        if low <= y <= high:
            axes.plot([x, x], [y, y], [0, COLUMN_HEIGHT], color=style.COLUMN_FILL, lw=2.4, alpha=0.6)
    for drone in range(flight.positions.shape[1]):
        _trail(axes, flight, drone, span)
    for ball in range(flight.balls.shape[1]):
        path = _within(flight.balls[:, ball], span, half)
        axes.plot(*path.T, color=style.BALL, lw=0.8, ls=(0, (3, 1.5)))
    for time in np.arange(flight.times[0], flight.times[-1], topview.BEAT):
        at = flight.positions[topview.nearest(flight, float(time))]
        if low <= at[:, 1].min() and at[:, 1].max() <= high:
            ring = at[topview.around(at[:, :2])] if len(at) > 2 else at
            axes.plot(*np.vstack((ring, ring[:1])).T, color=style.FAINT, lw=0.6)
    for time, drone, _ in flight.hits:
        x, y, z = flight.positions[topview.nearest(flight, time), drone]
        if low <= y <= high:
            axes.plot([x], [y], [z], marker="x", ms=6, mew=1.5, color=style.INK)
    _frame(axes, span, half)


def _trail(axes: Axes3D, flight: DrawnFlight, drone: int, span: tuple[float, float]) -> None:
    path = flight.positions[:, drone]
    inside = np.flatnonzero((path[:, 1] >= span[0]) & (path[:, 1] <= span[1]))
    if len(inside) < 2:
        return
    kept = inside[topview.samples(flight.times[inside])]
    pieces, colors = topview.strokes(path[kept], style.DRONES[drone % len(style.DRONES)], 0.35)
    axes.add_collection3d(Line3DCollection(pieces, colors=colors, linewidths=1.2, joinstyle="round"))


def _within(path: NDArray[np.float64], span: tuple[float, float], half: float) -> NDArray[np.float64]:
    """A path with NaN where it leaves the part that is shown."""
    outside = (path[:, 1] < span[0]) | (path[:, 1] > span[1]) | (np.abs(path[:, 0]) > half)
    return np.where(outside[:, None], np.nan, path)


def _frame(axes: Axes3D, span: tuple[float, float], half: float) -> None:
    low, high = span
    axes.set_xlim(-half, half)
    axes.set_ylim(low, high)
    axes.set_zlim(0, COLUMN_HEIGHT)
    axes.set_box_aspect((2 * half, high - low, COLUMN_HEIGHT), zoom=1.1)
    axes.view_init(elev=26, azim=-32)
    axes.grid(visible=False)
    axes.tick_params(labelsize=6, pad=-3)
    axes.set_zticks([0, 3])
    axes.set_xticks([-2, 2])
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.pane.set_facecolor("white")
        axis.pane.set_edgecolor(style.GRID)
