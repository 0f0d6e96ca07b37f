"""CFR and FM against the number of obstacles: the paper's two sweep figures, with intervals as bands."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from analysis.figures import style
from analysis.figures.style import Look

if TYPE_CHECKING:
    import pandas as pd

_LOG_FROM = 3.0  # ratio of the largest FM to the median from which a linear axis hides the tight formations
_LINEAR = 0.1  # m, FM below which the axis stays linear: straight flight has none at all


def draw_sweep(points: "pd.DataFrame", looks: Mapping[str, Look], xlabel: str, stamp: str) -> Figure:
    """Two panels above each other, one column wide.

    points: as from ``analysis.series.sweep`` (method, obstacles, cfr, cfr_low, cfr_high, fm, fm_low, fm_high).
    """
    with style.styled():
        figure = style.new(style.COLUMN, 3.55)
        upper, lower = figure.subplots(2, 1, sharex=True)
        for method in dict.fromkeys(points["method"]):
            rows = points[points["method"] == method].sort_values("obstacles")
            line(upper, rows, "obstacles", "cfr", looks[method], method)
            line(lower, rows, "obstacles", "fm", looks[method], method)
        upper.set_ylim(-0.03, 1.03)
        upper.set_ylabel("CFR")
        lower.set_ylabel("FM (m)")
        _fm_axis(lower, points)
        places = sorted(points["obstacles"].unique())
        lower.xaxis.set_major_locator(FixedLocator(places))
        lower.set_xlim(places[0] - _margin(places), places[-1] + _margin(places))
        lower.set_xlabel(xlabel)
        figure.align_ylabels([upper, lower])
        handles, names = upper.get_legend_handles_labels()
        fitting = style.legend_columns(names, style.COLUMN)
        figure.legend(handles, names, loc="outside upper center", ncols=fitting, columnspacing=1.2)
        style.put_stamp(figure, stamp)
        return style.settle(figure)


def line(axes: Axes, rows: "pd.DataFrame", over: str, key: str, look: Look, name: str) -> None:
    """A method's line with its band; a lone point gets an error bar, since a band of no width cannot be seen."""
    x, y, low, high = (rows[column].to_numpy(float) for column in (over, key, f"{key}_low", f"{key}_high"))
    face = look.color if look.marker not in "x+1" else None
    axes.plot(
        x,
        y,
        color=look.color,
        marker=look.marker,
        ls=look.line,
        mec="white" if face else look.color,
        mew=0.5 if face else 1,
        label=name,
        zorder=3,
    )
    axes.fill_between(x, low, high, color=look.color, alpha=0.16, lw=0, zorder=2)
    if len(x) == 1:
        axes.errorbar(x, y, yerr=[y - low, high - y], color=look.color, capsize=2, lw=0.8, zorder=2)


def _fm_axis(axes: Axes, points: "pd.DataFrame") -> None:
    """From zero; logarithmic above ``_LINEAR`` where methods differ by much, so centimetres and metres both show."""
    values = points[["fm_low", "fm", "fm_high"]].to_numpy(float)
    values = values[np.isfinite(values)]
    top = max(float(values.max()) * 1.12, _LINEAR) if values.size else 1.0
    if values.size == 0 or top < _LOG_FROM * max(float(np.median(values)), _LINEAR):
        axes.set_ylim(-0.03 * top, top)
        return
    axes.set_yscale("symlog", linthresh=_LINEAR, linscale=0.6)
    axes.set_ylim(-0.15 * _LINEAR, top)
    ticks = [0.0, *(t for t in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if t <= top)]
    axes.yaxis.set_major_locator(FixedLocator(ticks if len(ticks) <= 7 else [t for t in ticks if f"{t:e}"[0] != "2"]))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _margin(places: list[float]) -> float:
    return 0.06 * (places[-1] - places[0]) if len(places) > 1 else 1.0
