"""Learning curves: how a training went, period by period."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

from analysis.figures import style
from analysis.figures.style import LineStyle


def draw_learning(
    curves: pd.DataFrame, metrics: Sequence[tuple[str, str]], styles: Mapping[str, LineStyle], stamp: str
) -> Figure:
    """A row per metric, a column per learner with its own number of steps; two columns wide with several learners.

    One thin line per training run, the mean over a method's seeds in bold; a dot where a period of the curriculum
    begins. curves: method, learner, train_run, seed, steps, period and the metrics' columns.
    """
    shown = [(key, label) for key, label in metrics if curves[key].notna().any()]
    learners = list(dict.fromkeys(curves["learner"]))
    with style.styled():
        width = style.COLUMN if len(learners) == 1 else style.DOUBLE
        figure = style.new(width, 1.1 + 1.15 * len(shown))
        grid = figure.subplots(len(shown), len(learners), sharex="col", sharey="row", squeeze=False)
        for column, learner in enumerate(learners):
            part = curves[curves["learner"] == learner]
            for row, (key, label) in enumerate(shown):
                axes = grid[row, column]
                for method in dict.fromkeys(part["method"]):
                    runs = [run for _, run in part[part["method"] == method].groupby("train_run", sort=True)]
                    _method(axes, runs, key, styles[method])
                if column == 0:
                    axes.set_ylabel(label)
                top = float(curves[key].quantile(0.99)) * 1.1 or 1.0
                axes.set_ylim(*((-0.03, 1.03) if key.endswith(("collision_free", "cfr")) else (0, top)))
            _steps_axis(grid[-1, column], part, len(learners))
            if len(learners) > 1:
                grid[0, column].set_title(learner, loc="left")
        figure.align_ylabels(list(grid[:, 0]))
        _legend(figure, curves, styles, width)
        style.put_stamp(figure, stamp)
        return style.settle(figure)


def period_starts(run: pd.DataFrame) -> list[tuple[str, float]]:
    """Periods of one training in their order, and the steps at which they begin."""
    run = run.sort_values("steps")
    names = run["period"].astype(str)
    change = names.ne(names.shift())
    return list(zip(names[change], run["steps"].shift(fill_value=0)[change].astype(float), strict=True))


def _method(axes: Axes, runs: Sequence[pd.DataFrame], key: str, look: LineStyle) -> None:
    width, alpha = (0.6, 0.45) if len(runs) > 1 else (1.2, 1.0)
    for run in runs:
        known = run[run[key].notna()].sort_values("steps")
        axes.plot(known["steps"], known[key], color=look.color, ls=look.line, lw=width, alpha=alpha)
        starts = [steps for _, steps in period_starts(run)[1:]]
        heights = np.interp(starts, known["steps"], known[key]) if len(known) else []
        axes.plot(starts, heights, color=look.color, marker="o", ms=4, mec="white", mew=0.6, ls="", zorder=4)
    if len(runs) > 1:
        steps, average = _mean(runs, key)
        axes.plot(steps, average, color=look.color, lw=1.5, ls=look.line)


def _steps_axis(axes: Axes, part: pd.DataFrame, learners: int) -> None:
    axes.set_xlim(0, part["steps"].max())
    axes.xaxis.set_major_locator(MaxNLocator(6 if learners == 1 else 4))
    axes.xaxis.set_major_formatter(FuncFormatter(_millions))
    axes.set_xlabel("Environment steps")


def _legend(figure: Figure, curves: pd.DataFrame, styles: Mapping[str, LineStyle], width: float) -> None:
    counts = curves.groupby("method", sort=False)["train_run"].nunique()
    seeds = {str(name): int(count) for name, count in counts.items()}
    handles = [Line2D([], [], color=styles[name].color, ls=styles[name].line, lw=1.5) for name in seeds]
    names = [name if count == 1 else f"{name} (mean of {count})" for name, count in seeds.items()]
    if curves.groupby("train_run")["period"].nunique().max() > 1:
        handles.append(Line2D([], [], color=style.FAINT, marker="o", ms=4, mec="white", ls=""))
        names.append("a period begins")
    figure.legend(handles, names, loc="outside upper center", ncols=style.legend_columns(names, width))


def _mean(runs: Sequence[pd.DataFrame], key: str) -> tuple[np.ndarray, np.ndarray]:
    """Mean over runs on a common grid of steps, as far as every run has got."""
    known = [run[["steps", key]].dropna().sort_values("steps") for run in runs if run[key].notna().any()]
    start, stop = max(run["steps"].iloc[0] for run in known), min(run["steps"].iloc[-1] for run in known)
    steps = np.linspace(start, stop, 200)
    return steps, np.mean([np.interp(steps, run["steps"], run[key]) for run in known], axis=0)


def _millions(value: float, _: int) -> str:
    if value == 0:
        return "0"
    return f"{value / 1e6:g} M" if abs(value) >= 1e6 else f"{value / 1e3:g} k"
