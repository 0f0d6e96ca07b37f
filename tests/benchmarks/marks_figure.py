"""How soon trainings reach a mark: CFR and FM of their judgements against minutes and steps."""

import pandas as pd
from matplotlib.figure import Figure

from analysis.figures import style

PANELS = (("cfr", "CFR"), ("fm", "FM (m)"))


def draw_marks(curves: pd.DataFrame, cfr: float, fm: float) -> Figure:
    """CFR and FM (rows) against minutes and environment steps (columns); the mark as a dashed line; both columns wide.

    curves: learner, seed, run, steps, minutes, cfr, fm; one row per judgement, one line per run.
    """
    looks = style.line_styles(list(dict.fromkeys(curves["learner"])))
    with style.styled():
        figure = style.new(style.DOUBLE, 3.6)
        grid = figure.subplots(2, 2, sharex="col", sharey="row")
        for row, ((key, label), mark) in enumerate(zip(PANELS, (cfr, fm), strict=True)):
            for axes, time, scale in zip(grid[row], ("minutes", "steps"), (1.0, 1e-6), strict=True):
                for _, run in curves.groupby("run", sort=False):
                    look = looks[run["learner"].iloc[0]]
                    axes.plot(run[time] * scale, run[key], color=look.color, marker=look.marker, ls=look.line, ms=3)
                axes.axhline(mark, color=style.FAINT, lw=0.8, ls=(0, (4, 2)))
            grid[row][0].set_ylabel(label)
        grid[0][0].set_ylim(-0.03, 1.03)
        if len(curves):
            grid[1][0].set_ylim(0, max(2 * fm, min(float(curves["fm"].max()) * 1.05, 10 * fm)))
        grid[1][0].set_xlabel("Minutes, compiling and judging included")
        grid[1][1].set_xlabel("Environment steps (M)")
        for name, look in looks.items():
            grid[0][0].plot([], [], color=look.color, marker=look.marker, ls=look.line, ms=3, label=name)
        handles, names = grid[0][0].get_legend_handles_labels()
        if names:
            figure.legend(handles, names, loc="outside upper center", ncols=3)
        return style.settle(figure)
