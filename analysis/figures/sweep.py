"""CFR and FM against the number of obstacles: the paper's two sweep figures, with intervals as bands."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from analysis.figures import style
from analysis.figures.style import LineStyle

HIGH = 0.8
"""CFR from which lines lie too close to each other in a panel from 0 to 1."""
CROWDED = 3
"""Methods with points up there that get a panel of their own."""

_LOG_FROM = 3.0  # ratio of the largest FM to the median from which a linear axis hides the tight formations
_FLOOR = 0.01  # m, where a logarithmic axis begins: straight flight has no FM at all
_SIDE = 0.006  # of the axis, that neighbouring methods' markers are moved apart


def draw_sweep(points: pd.DataFrame, styles: Mapping[str, LineStyle], xlabel: str, stamp: str) -> Figure:
    """CFR from 0 to 1, where it is crowded once more from ``HIGH`` on, and FM; one column wide.

    points: as from ``analysis.figures.series.sweep`` (method, obstacles, cfr, cfr_low, cfr_high, fm, fm_low, fm_high).
    """
    crowded = points.loc[points["cfr"] >= HIGH, "method"].nunique() >= CROWDED
    heights = (1.0, 0.9, 1.0) if crowded else (1.0, 1.0)
    names = list(dict.fromkeys(points["method"]))
    across = style.legend_columns(names, style.COLUMN)
    with style.styled():
        figure = style.new(style.COLUMN, 0.75 + 0.16 * -(-len(names) // across) + 1.25 * sum(heights))
        panels = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
        places = sorted(points["obstacles"].unique())
        margin = 0.06 * (places[-1] - places[0]) if len(places) > 1 else 1.0
        span = places[-1] - places[0] + 2 * margin
        for number, method in enumerate(names):
            rows = points[points["method"] == method].sort_values("obstacles")
            rows = rows.assign(obstacles=rows["obstacles"] + _SIDE * span * (number - (len(names) - 1) / 2))
            for axes in panels[:-1]:
                line(axes, rows, "obstacles", "cfr", styles[method], method)
            line(panels[-1], rows, "obstacles", "fm", styles[method], method)
        panels[0].set(ylim=(-0.03, 1.03), ylabel="CFR")
        if crowded:
            panels[1].set(ylim=(HIGH - 0.005, 1.005), ylabel=f"CFR ≥ {HIGH:g}")
        panels[-1].set_ylabel("FM (m)")
        fm_axis(panels[-1], points)
        panels[-1].xaxis.set_major_locator(FixedLocator(places))
        panels[-1].set_xlim(places[0] - margin, places[-1] + margin)
        panels[-1].set_xlabel(xlabel)
        figure.align_ylabels(list(panels))
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=across, columnspacing=1.2)
        style.put_stamp(figure, stamp)
        return style.settle(figure)


def line(axes: Axes, rows: pd.DataFrame, over: str, key: str, look: LineStyle, name: str) -> None:
    """A method's line with its band; a lone point gets an error bar, since a band of no width cannot be seen."""
    x, y, low, high = (rows[column].to_numpy(float) for column in (over, key, f"{key}_low", f"{key}_high"))
    face = look.marker not in "x+1"
    edge = {"mec": "white", "mew": 0.5} if face else {"mec": look.color, "mew": 1.0}
    axes.plot(x, y, color=look.color, marker=look.marker, ls=look.line, label=name, zorder=3, **edge)  # type: ignore[arg-type]
    axes.fill_between(x, low, high, color=look.color, alpha=0.12, lw=0, zorder=2)
    if len(x) == 1:
        axes.errorbar(x, y, yerr=[y - low, high - y], color=look.color, capsize=2, lw=0.8, zorder=2)


def fm_axis(axes: Axes, points: pd.DataFrame) -> None:
    """Linear from zero; logarithmic throughout, and said so, where methods differ by much."""
    values = points[["fm_low", "fm", "fm_high"]].to_numpy(float)
    values = values[np.isfinite(values)]
    top = float(values.max()) * 1.12 if values.size else 1.0
    if values.size == 0 or top < _LOG_FROM * max(float(np.median(values)), _FLOOR):
        axes.set_ylim(-0.03 * top, top)
        return
    axes.set_yscale("log", nonpositive="clip")
    axes.set_ylim(max(_FLOOR, float(values.min()) / 1.3), top)
    axes.set_ylabel("FM (m, log)")
    axes.yaxis.set_major_locator(FixedLocator([t for t in (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0) if t <= top]))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
