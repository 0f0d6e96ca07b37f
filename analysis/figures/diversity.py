"""Styles of a study's trials: speed, height, formation and smoothness side by side, best satisfaction rate on top."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from analysis.figures import style

_SHOWN = 24  # trials


def draw_diversity(styles: pd.DataFrame, labels: Mapping[str, str], stamp: str) -> Figure:
    """A panel for SR and one for every quantity, a line for every trial; two columns wide.

    styles: as from ``analysis.stats.diversity.table``. labels: axis label of every quantity.
    """
    shown = styles.head(_SHOWN)
    y = np.arange(len(shown))
    equal = shown["equal"].to_numpy(bool)
    with style.styled():
        figure = style.new(style.DOUBLE, 1.2 + 0.135 * len(shown))
        panels = figure.subplots(1, 1 + len(labels), sharey=True)
        for axes, (column, label) in zip(panels, {"sr": "Satisfaction rate", **labels}.items(), strict=True):
            value = shown[column].to_numpy(float)
            error = np.clip([value - shown[f"{column}_low"], shown[f"{column}_high"] - value], 0, None)
            for chosen, color in ((equal, style.PALETTE[0]), (~equal, style.FAINT)):
                axes.errorbar(
                    value[chosen], y[chosen], xerr=error[:, chosen], fmt="o", ms=3, color=color, elinewidth=0.9
                )
            axes.set_xlabel(label)
            axes.margins(x=0.08)
            axes.locator_params(axis="x", nbins=4)
            axes.tick_params(axis="y", length=0)
            axes.grid(axis="y", visible=False)
        panels[0].set_xlim(-0.02, 1.02)
        panels[0].set_yticks(y, [f"{trial:d}" for trial in shown["trial"]], fontsize=6)
        panels[0].set_ylim(len(shown) - 0.4, -0.6)
        panels[0].set_ylabel("Trial")
        handles = [Line2D([], [], marker="o", ls="", ms=3, color=c) for c in (style.PALETTE[0], style.FAINT)]
        names = ["SR that cannot be told from the best", "lower SR"]
        figure.legend(handles, names, loc="outside upper center", ncols=2)
        left_out = len(styles) - len(shown)
        style.put_stamp(figure, f"best {len(shown)} of {len(styles)} trials · {stamp}" if left_out else stamp)
        return style.settle(figure)
