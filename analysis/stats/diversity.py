"""Styles of flying among trials whose weights satisfy equally often (paper, Sec. VI-B: some brake, some climb).

SR says how often all objectives hold, not how: two weight vectors of one SR may fly slower or faster, higher or lower,
tighter or looser. The rows of the trials' own evaluations tell.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd

from analysis.data.rows import read_episodes
from analysis.data.runs import Run
from analysis.stats.intervals import mean, wilson
from analysis.stats.paired import ALPHA, holm, mcnemar


class Quantity(NamedTuple):
    """What a style is told by: a column of the rows, and how far apart two means of it are another style."""

    column: str
    name: str
    unit: str
    apart: float

    @property
    def label(self) -> str:
        """The name as it stands at an axis."""
        return f"{self.name[0].upper()}{self.name[1:]}" + (f" ({self.unit})" if self.unit else "")

    def words(self, *values: float) -> str:
        """The name and so many values of it."""
        return f"{self.name} {' to '.join(f'{value:.2g}' for value in values)} {self.unit}".strip()


QUANTITIES = (
    Quantity("mean_speed", "speed", "m/s", 0.1),
    Quantity("height_error", "height error", "m", 0.1),
    Quantity("fm", "FM", "m", 0.1),
    Quantity("throttle_change", "throttle change", "", 0.005),
)


def with_intervals(trials: pd.DataFrame) -> pd.DataFrame:
    """Trials with Wilson's interval of their SR, in the columns ``sr_low`` and ``sr_high``."""
    ends = [wilson(int(k), int(n)) for k, n in zip(trials["sr_k"], trials["sr_n"], strict=True)]
    return trials.assign(sr_low=[low for low, _ in ends], sr_high=[high for _, high in ends])


def table(run: Run, trials: pd.DataFrame) -> pd.DataFrame:
    """One row per finished trial that kept its episodes, in the order of ``trials`` (best SR first).

    Columns: trial, sr, sr_low, sr_high, equal (see ``_equal``), and of every quantity the mean over episodes with its
    95 % interval: ``fm``, ``fm_low``, ``fm_high`` and so on.
    """
    found: list[dict[str, object]] = []
    satisfied: list[pd.Series] = []
    for _, trial in trials.iterrows():
        path = run.folder / str(trial.get("run")) / "episodes.parquet"
        if not path.is_file():
            continue
        rows = read_episodes(path)
        facts = {name: trial[name] for name in ("trial", "sr", "sr_low", "sr_high")}
        satisfied.append(rows.set_index("scenario_id")["sr"])
        for quantity in QUANTITIES:
            values = rows[quantity.column].to_numpy(float)
            average = mean(values[np.isfinite(values)])
            figures = (average.value, average.low, average.high) if average else (float("nan"),) * 3
            facts |= zip((quantity.column, f"{quantity.column}_low", f"{quantity.column}_high"), figures, strict=True)
        found.append(facts)
    return pd.DataFrame(found).assign(equal=_equal(satisfied))


def _equal(satisfied: list[pd.Series]) -> list[bool]:
    """Which trials' SR is not told from the first one's, the best: exact McNemar on shared episodes, Holm-adjusted.

    satisfied: flags (n,) of a trial by the episode's number in the study's bank.
    """
    shared = [satisfied[0].align(own, join="inner") for own in satisfied[1:]]
    p_values = [mcnemar(best, own).p for best, own in shared]
    return [True] * len(satisfied[:1]) + [bool(p >= ALPHA) for p in holm(p_values)]


def spread(styles: pd.DataFrame) -> list[tuple[Quantity, float, float, bool]]:
    """Of every quantity the least and largest mean among trials of equal SR, and whether these are two styles.

    They are where the means differ by ``apart`` and their intervals do not meet. Empty with fewer than two trials.
    """
    equal = styles[styles["equal"]] if len(styles) else styles
    if len(equal) < 2:
        return []
    found = []
    for quantity in QUANTITIES:
        ordered = equal.sort_values(quantity.column)
        least, most = ordered.iloc[0], ordered.iloc[-1]
        low, high = float(least[quantity.column]), float(most[quantity.column])
        clear = most[f"{quantity.column}_low"] > least[f"{quantity.column}_high"]
        found.append((quantity, low, high, bool(clear and high - low >= quantity.apart)))
    return found
