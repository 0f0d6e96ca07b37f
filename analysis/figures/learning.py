"""Learning curves: how a training went, period by period."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from analysis.figures import style
from analysis.figures.style import Look

if TYPE_CHECKING:
    import pandas as pd


def draw_learning(
    curves: "pd.DataFrame", metrics: Sequence[tuple[str, str]], looks: Mapping[str, Look], stamp: str
) -> Figure:
    """One panel per metric, one thin line per training run, the mean over a method's seeds in bold; one column wide.

    curves: method, train_run, seed, steps, period and the metrics' columns. Periods are marked where all runs agree.
    """
    shown = [(key, label) for key, label in metrics if curves[key].notna().any()]
    with style.styled():
        figure = style.new(style.COLUMN, 0.95 + 1.15 * len(shown))
        panels = np.atleast_1d(figure.subplots(len(shown), 1, sharex=True))
        for axes, (key, label) in zip(panels, shown, strict=True):
            for method in dict.fromkeys(curves["method"]):
                runs = [run for _, run in curves[curves["method"] == method].groupby("train_run", sort=True)]
                look = looks[method]
                thin = {"lw": 0.6, "alpha": 0.45} if len(runs) > 1 else {"lw": 1.2}
                for run in runs:
                    known = run[run[key].notna()]
                    axes.plot(known["steps"], known[key], color=look.color, ls=look.line, **thin)
                if len(runs) > 1:
                    steps, average = _mean(runs, key)
                    axes.plot(steps, average, color=look.color, lw=1.5, ls=look.line)
                axes.plot([], [], color=look.color, lw=1.5, ls=look.line, label=_legend(method, runs))
            axes.set_ylabel(label)
            top = curves[key].quantile(0.99)
            axes.set_ylim(*((-0.03, 1.03) if key.endswith(("collision_free", "cfr")) else (0, float(top) * 1.1 or 1.0)))
        _periods(panels, curves)
        panels[-1].set_xlim(0, curves["steps"].max())
        panels[-1].xaxis.set_major_locator(MaxNLocator(6))
        panels[-1].xaxis.set_major_formatter(FuncFormatter(_millions))
        panels[-1].set_xlabel("Environment steps")
        figure.align_ylabels(panels)
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=style.legend_columns(names, style.COLUMN))
        style.put_stamp(figure, stamp)
        return style.settle(figure)


def period_starts(curves: "pd.DataFrame") -> list[tuple[str, float]]:
    """Periods and the steps at which they begin, when all trainings went through the same; empty otherwise."""
    runs = [run.sort_values("steps") for _, run in curves.groupby("train_run")]
    found = []
    for run in runs:
        names = run["period"].astype(str)
        change = names.ne(names.shift())
        before = run["steps"].shift(fill_value=0)[change]
        found.append(list(zip(names[change], before, strict=True)))
    same = all([name for name, _ in starts] == [name for name, _ in found[0]] for starts in found)
    step = curves["steps"].max() / 20
    near = same and all(abs(a[1] - b[1]) <= step for starts in found for a, b in zip(starts, found[0], strict=True))
    return [(name, float(start)) for name, start in found[0]] if near else []


def _periods(panels: NDArray[np.object_], curves: "pd.DataFrame") -> None:
    """Vertical lines where a period begins, its name above the first panel."""
    starts = period_starts(curves)
    end = float(curves["steps"].max())
    for number, (name, start) in enumerate(starts):
        stop = starts[number + 1][1] if number + 1 < len(starts) else end
        for axes in panels:
            if number:
                axes.axvline(start, color=style.FAINT, lw=0.6, ls=(0, (2, 2)), zorder=1)
        narrow = stop - start < 0.1 * end  # a short first period: its name may lean over to the next one's share
        panels[0].text(
            start if narrow else (start + stop) / 2,
            1.02,
            name,
            ha="left" if narrow else "center",
            va="bottom",
            transform=panels[0].get_xaxis_transform(),
            fontsize=7,
            color=style.FAINT,
        )


def _mean(runs: Sequence["pd.DataFrame"], key: str) -> tuple[np.ndarray, np.ndarray]:
    """Mean over runs on a common grid of steps, as far as every run has got."""
    known = [run[["steps", key]].dropna().sort_values("steps") for run in runs if run[key].notna().any()]
    start, stop = max(run["steps"].iloc[0] for run in known), min(run["steps"].iloc[-1] for run in known)
    steps = np.linspace(start, stop, 200)
    return steps, np.mean([np.interp(steps, run["steps"], run[key]) for run in known], axis=0)


def _legend(method: str, runs: Sequence) -> str:
    return method if len(runs) == 1 else f"{method} (mean of {len(runs)})"


def _millions(value: float, _: int) -> str:
    if value == 0:
        return "0"
    return f"{value / 1e6:g} M" if abs(value) >= 1e6 else f"{value / 1e3:g} k"
