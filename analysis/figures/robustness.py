"""CFR and FM against one disturbance after another: the robustness figure of a deployment."""

from collections.abc import Mapping

import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures import style
from analysis.figures.style import LineStyle
from analysis.figures.sweep import fm_axis, line


def draw_robustness(
    points: pd.DataFrame, axes: Mapping[str, tuple[str, float]], styles: Mapping[str, LineStyle], stamp: str
) -> Figure:
    """CFR above FM, a column of panels for each varied quantity, bands for intervals; two columns wide.

    points: as from ``analysis.tables.deployment.curves``, of one world. axes: label and factor of every quantity.
    """
    shown = [axis for axis in axes if axis in set(points["axis"])]
    with style.styled():
        figure = style.new(style.DOUBLE if len(shown) > 1 else style.COLUMN, 3.3)
        panels = figure.subplots(2, len(shown), sharex="col", sharey="row", squeeze=False)
        for (upper, lower), axis in zip(panels.T, shown, strict=True):
            label, factor = axes[axis]
            part = points[points["axis"] == axis]
            for method in dict.fromkeys(part["method"]):
                rows = part[part["method"] == method].sort_values("value")
                rows = rows.assign(value=factor * rows["value"])
                line(upper, rows, "value", "cfr", styles[method], method)
                line(lower, rows, "value", "fm", styles[method], method)
            lower.set_xlabel(label)
        panels[0, 0].set_ylim(-0.03, 1.03)
        panels[0, 0].set_ylabel("CFR")
        panels[1, 0].set_ylabel("FM (m)")
        fm_axis(panels[1, 0], points)
        figure.align_ylabels(list(panels[:, 0]))
        found = _legend(panels.ravel().tolist())
        fitting = style.legend_columns(list(found), figure.get_figwidth())
        figure.legend(list(found.values()), list(found), loc="outside upper center", ncols=fitting)
        style.put_stamp(figure, stamp)
        return style.settle(figure)


def _legend(panels: list[Axes]) -> dict[str, Artist]:
    """Handles by name, each name once."""
    pairs = [pair for panel in panels for pair in zip(*panel.get_legend_handles_labels(), strict=True)]
    return {name: handle for handle, name in pairs}
