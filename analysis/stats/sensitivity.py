"""How much the choice of weights hangs on the thresholds: SR and the winner over a joint grid of thresholds.

An episode satisfies when all four objectives hold (paper, Sec. V-B1). Its row keeps the quantities behind each of
them, so that other thresholds can be judged without flying, let alone training, again. The grid is where the data are:
quantiles of what the trials flew, with the thresholds in use and the paper's own FM among them.
"""

from collections.abc import Mapping
from itertools import product

import numpy as np
import pandas as pd

from analysis.data.published import published

QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Of all trials' episodes that were neither late nor hit anything, taken as thresholds."""

QUANTITIES = {
    "formation_threshold": "fm",
    "speed_threshold": "speed_error",
    "height_threshold": "height_error",
    "action_threshold": "throttle_change",
}
"""Thresholds of ``conf/eval`` and the column of the rows that each of them bounds."""

VARIED = ("formation_threshold", "action_threshold")
"""Of those, the ones that are moved; the others stay where they are in use."""


def grid(rows: Mapping[int, pd.DataFrame], in_use: Mapping[str, float]) -> dict[str, list[float]]:
    """Values of every threshold, rising. rows: trial -> its episodes; in_use: the settings ``eval``."""
    flown = pd.concat(rows.values(), ignore_index=True)
    flown = flown[flown["cfr"].astype(bool)]
    paper = published("ours", "mixed")
    values = {}
    for name in VARIED:
        own = flown[QUANTITIES[name]].to_numpy(float)
        quantiles = np.quantile(own[np.isfinite(own)], QUANTILES) if np.isfinite(own).any() else np.empty(0)
        known = [float(in_use[name]), *([paper.fm] if name == "formation_threshold" and paper and paper.fm else [])]
        values[name] = sorted({*known, *(float(f"{value:.3g}") for value in quantiles)})
    return values


def satisfied(rows: pd.DataFrame, thresholds: Mapping[str, float]) -> np.ndarray:
    """Whether each episode satisfies all four objectives under other thresholds, those of ``VARIED``."""
    held = rows["ok_flight"].to_numpy(bool) & rows["ok_obstacle"].to_numpy(bool)
    below = [rows[QUANTITIES[name]].to_numpy(float) < thresholds[name] for name in VARIED]
    return np.logical_and.reduce([held, *below])


def sweep(rows: Mapping[int, pd.DataFrame], in_use: Mapping[str, float]) -> pd.DataFrame:
    """SR of every trial at every point of the grid: the thresholds, in_use (all of them), trial, sr."""
    values = grid(rows, in_use)
    found = []
    for point in product(*values.values()):
        thresholds = dict(zip(values, point, strict=True))
        same = all(thresholds[name] == float(in_use[name]) for name in VARIED)
        for trial, episodes in rows.items():
            sr = float(satisfied(episodes, thresholds).mean())
            found.append({**thresholds, "in_use": same, "trial": trial, "sr": sr})
    return pd.DataFrame(found)


def winners(table: pd.DataFrame) -> pd.DataFrame:
    """Per point of the grid: the trial of highest SR, its SR, the median SR and the rank correlation with those in use.

    Of equals the one wins that ``sweep`` was given first.
    """
    usual = table[table["in_use"]].set_index("trial")["sr"]
    found = []
    for key, group in table.groupby([*VARIED, "in_use"], sort=False):
        rates = group.set_index("trial")["sr"]
        point = dict(zip((*VARIED, "in_use"), key, strict=True))
        alike = rates.corr(usual, method="spearman") if rates.nunique() > 1 and usual.nunique() > 1 else float("nan")
        summary = {"trial": rates.idxmax(), "sr": rates.max(), "median": rates.median(), "spearman": alike}
        found.append(point | summary)
    return pd.DataFrame(found)
