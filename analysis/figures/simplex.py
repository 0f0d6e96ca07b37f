"""Satisfaction rate over the weight simplex: the paper's tetrahedron, ternary slices through it, and the ranked trials.

Four weights that sum to 1 fill a tetrahedron. Its picture shows where trials lie, but hides depth; the four slices
(trials sorted by their action weight into quarters, the other three weights shown as shares of the rest) can be read
off exactly, and the ranking shows each trial's weights beside its rate and interval.
"""

from collections.abc import Sequence
from typing import cast

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from analysis.figures import style

WEIGHTS = ("w_formation", "w_flight", "w_obstacle", "w_action")
_NAMES = ("formation", "flight", "obstacle", "action")
_SHADES = ("#0072B2", "#56B4E9", "#D55E00", "#999999")  # of the four weights in the ranking
_SHOWN = 30  # trials in the ranking

_TRIANGLE = np.array([[0.5, np.sqrt(3) / 2], [0.0, 0.0], [1.0, 0.0]])  # formation, flight, obstacle
_TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)


def draw_simplex(trials: pd.DataFrame, stamp: str) -> Figure:
    """Tetrahedron and four slices, two columns wide. trials: w_* that sum to 1, sr in [0, 1]; darker is higher."""
    weights = _weights(trials)
    rates = trials["sr"].to_numpy(float)
    norm = Normalize(0, max(float(rates.max()), 0.05))
    with style.styled():
        figure = style.new(style.DOUBLE, 3.25)
        left, right = cast(Sequence[SubFigure], figure.subfigures(1, 2, width_ratios=(1, 1.28)))
        body = left.subplots()
        _tetrahedron(body, weights, trials, norm)
        body.set_title("(a)  all trials", fontsize=7.5, loc="left")
        panels = right.subplots(2, 2)
        for number, (axes, chosen) in enumerate(zip(panels.flat, _quarters(weights[:, 3]), strict=True)):
            _ternary(axes, weights[chosen], rates[chosen], norm, best=int(np.argmax(rates)) in chosen)
            action = weights[chosen, 3]
            span = f"action weight {action.min():.2f} to {action.max():.2f}" if len(chosen) else "no trial"
            axes.set_title(f"({'bcde'[number]})  {span}", fontsize=7.5, loc="left")
        scale = figure.colorbar(_scale(norm), ax=panels, shrink=0.75, aspect=26, pad=0.04, label="Satisfaction rate")
        scale.outline.set_linewidth(0.4)
        style.put_stamp(figure, stamp)
        return style.settle(figure)


def draw_ranking(trials: pd.DataFrame, stamp: str) -> Figure:
    """Trials in order of their rate: weights as a bar of parts, SR with its Wilson interval beside it; one column wide.

    trials: sorted, w_*, sr, sr_low, sr_high, trial.
    """
    shown = trials.head(_SHOWN)
    y = np.arange(len(shown))
    with style.styled():
        figure = style.new(style.COLUMN, 1.25 + 0.135 * len(shown))
        bars, dots = figure.subplots(1, 2, sharey=True, width_ratios=(1.35, 1))
        start = np.zeros(len(shown))
        for column, name, shade in zip(WEIGHTS, _NAMES, _SHADES, strict=True):
            width = shown[column].to_numpy(float)
            bars.barh(y, width, left=start, height=0.74, color=shade, label=name, lw=0)
            start += width
        bars.set(xlim=(0, 1), xlabel="Weights", ylabel="Trial")
        bars.set_yticks(y, [f"{trial:d}" for trial in shown["trial"]], fontsize=6)
        bars.set_ylim(len(shown) - 0.4, -0.6)
        bars.tick_params(axis="y", length=0)
        bars.grid(False)
        bars.spines["left"].set_visible(False)
        rate = shown["sr"].to_numpy(float)
        error = np.clip([rate - shown["sr_low"].to_numpy(float), shown["sr_high"].to_numpy(float) - rate], 0, None)
        dots.errorbar(rate, y, xerr=error, fmt="o", ms=3, color=style.INK, ecolor=style.FAINT, elinewidth=0.9)
        dots.set(xlim=(-0.02, 1.02), xlabel="Satisfaction rate")
        dots.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
        bars.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
        dots.tick_params(axis="y", length=0)
        dots.grid(axis="y", visible=False)
        figure.legend(
            *bars.get_legend_handles_labels(), loc="outside upper center", ncols=4, columnspacing=1.0, handlelength=1.0
        )
        left_out = len(trials) - len(shown)
        style.put_stamp(figure, f"best {len(shown)} of {len(trials)} trials · {stamp}" if left_out else stamp)
        return style.settle(figure)


def barycentric(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Place of weights (n, 3) in a triangle of side 1: formation up, flight left, obstacle right. Returns (n, 2)."""
    shares = weights / weights.sum(axis=1, keepdims=True)
    return np.asarray(shares @ _TRIANGLE)


def _scale(norm: Normalize) -> ScalarMappable:
    """Colour scale of the rates."""
    return ScalarMappable(norm, style.SEQUENTIAL)


def _weights(trials: pd.DataFrame) -> NDArray[np.float64]:
    weights = trials[list(WEIGHTS)].to_numpy(float)
    if len(weights) == 0 or not np.allclose(weights.sum(axis=1), 1, atol=1e-3) or (weights < -1e-9).any():
        raise ValueError("trials need weights on the simplex: four numbers, none negative, that sum to 1")
    return weights


def _quarters(values: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """Indices in four groups of (nearly) equal size, from the smallest values to the largest."""
    return np.array_split(np.argsort(values, kind="stable"), 4)


def _ternary(axes: Axes, weights: NDArray, rates: NDArray, norm: Normalize, best: bool) -> None:
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.set(xlim=(-0.24, 1.24), ylim=(-0.15, 1.0))
    outline = np.vstack([_TRIANGLE, _TRIANGLE[:1]])
    axes.plot(*outline.T, color=style.INK, lw=0.7, zorder=1)
    for share in (0.25, 0.5, 0.75):
        for corner in range(3):
            one, other = (_TRIANGLE[k] for k in range(3) if k != corner)
            ends = share * _TRIANGLE[corner] + (1 - share) * np.array([one, other])
            axes.plot(*ends.T, color=style.GRID, lw=0.5, zorder=0)
    for place, name, ha, va, shift in zip(
        _TRIANGLE,
        _NAMES,
        ("left", "center", "center"),
        ("center", "top", "top"),
        ((0.05, 0), (0, -0.04), (0, -0.04)),
        strict=False,
    ):
        axes.text(place[0] + shift[0], place[1] + shift[1], name, ha=ha, va=va, fontsize=6.5)
    if len(weights):
        order = np.argsort(rates, kind="stable")  # the highest on top
        x, y = barycentric(weights[order, :3] + 1e-12).T
        axes.scatter(x, y, c=rates[order], cmap=style.SEQUENTIAL, norm=norm, s=17, lw=0.35, ec=style.INK, zorder=3)
        if best:
            axes.scatter(x[-1], y[-1], s=58, fc="none", ec=style.BALL, lw=1.1, zorder=4)


def _tetrahedron(axes: Axes, weights: NDArray, trials: pd.DataFrame, norm: Normalize) -> None:
    """Parallel projection with every corner on the outline; near points are larger, the hidden edge is dashed."""
    rates = trials["sr"].to_numpy(float)
    axes.set_axis_off()
    axes.set_aspect("equal")
    corners = _view(_TETRAHEDRON)
    for one in range(4):
        for other in range(one + 1, 4):
            behind = (one, other) == (1, 2)  # flight to obstacle, seen through the body
            line = {"ls": (0, (3, 2)), "color": style.FAINT, "lw": 0.6} if behind else {"color": style.INK, "lw": 0.8}
            axes.plot(*corners[[one, other], :2].T, zorder=1, **line)  # type: ignore[arg-type]
    middle = corners[:, :2].mean(axis=0)
    for corner, name in zip(corners, _NAMES, strict=True):
        away = corner[:2] - middle
        place = corner[:2] + np.array([0.2, 0.1]) * away / np.linalg.norm(away)
        axes.text(place[0], place[1], name, ha="center", va="center", fontsize=8)
    points = _view(weights @ _TETRAHEDRON)
    order = np.argsort(points[:, 2], kind="stable")
    depth = (points[order, 2] - corners[:, 2].min()) / np.ptp(corners[:, 2])
    x, y = points[order, :2].T
    size = 12 + 26 * depth
    axes.scatter(x, y, c=rates[order], cmap=style.SEQUENTIAL, norm=norm, s=size, lw=0.35, ec=style.INK, zorder=3)
    best = int(np.argmax(rates))
    axes.scatter(points[best, 0], points[best, 1], s=80, fc="none", ec=style.BALL, lw=1.1, zorder=4)
    text = f"best: trial {trials['trial'].iloc[best]}, SR {rates[best]:.2f}"
    axes.text(0.0, 0.02, text, ha="left", va="bottom", fontsize=7.5, color=style.BALL, transform=axes.transAxes)
    axes.margins(0.05)


def _view(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn points (n, 3) towards the viewer: formation up, action in front. Columns: right, up, towards the viewer."""
    up = _TETRAHEDRON[0]
    right = _TETRAHEDRON[2] - _TETRAHEDRON[1]
    right = right / np.linalg.norm(right)
    basis = np.stack([right, up, np.cross(right, up)])
    if (basis @ _TETRAHEDRON[3])[2] < 0:  # mirror the depth axis so that action comes forward
        basis[2] *= -1
    around, over = np.radians(12.0), np.radians(24.0)
    turn = np.array([[np.cos(around), 0, np.sin(around)], [0, 1, 0], [-np.sin(around), 0, np.cos(around)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(over), -np.sin(over)], [0, np.sin(over), np.cos(over)]])
    return np.asarray(points @ basis.T @ turn.T @ tilt.T)
