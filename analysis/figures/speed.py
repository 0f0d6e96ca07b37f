"""What a second of training is spent on, learner by learner."""

from collections.abc import Sequence

import pandas as pd
from matplotlib.figure import Figure

from analysis.figures import style


def draw_speeds(speeds: pd.DataFrame, parts: Sequence[str]) -> Figure:
    """One bar per row: microseconds per environment step, divided into ``parts``; both columns wide.

    speeds: learner, mode, steps_per_second and, for every part, its share of the time.
    """
    with style.styled():
        figure = style.new(style.DOUBLE, 0.8 + 0.28 * len(speeds))
        axes = figure.subplots()
        names = [f"{learner}, {mode}" for learner, mode in zip(speeds["learner"], speeds["mode"], strict=True)]
        cost = 1e6 / speeds["steps_per_second"]
        left = 0 * cost
        for part, color in zip(parts, (*style.PALETTE, style.FAINT), strict=False):
            axes.barh(range(len(speeds)), speeds[part] * cost, left=left, color=color, height=0.7, label=part)
            left = left + speeds[part] * cost
        for row, rate in enumerate(speeds["steps_per_second"]):
            axes.text(left.iloc[row], row, f"  {rate:,.0f}/s", va="center", fontsize=7)
        axes.set_yticks(range(len(speeds)), names)
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
        axes.margins(x=0.12)
        axes.set_xlabel("Microseconds per environment step")
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
        return style.settle(figure)
