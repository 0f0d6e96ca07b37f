"""How much the choice of weights hangs on the thresholds: SR and the winner as each objective's threshold moves.

An episode satisfies when all four objectives hold (paper, Sec. IV-B1). Its row keeps the quantities behind each of
them, so that other thresholds can be judged without flying, let alone training, again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

FACTORS = (0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0)
"""Multiples of the formation and the action threshold."""


@dataclass(frozen=True)
class Threshold:
    """What an objective is judged by: ``quantity`` of a row, in ``unit``, and the value in use."""

    objective: str
    quantity: str
    unit: str
    value: float


def thresholds(evaluation: Mapping[str, float], hit_radius: float) -> list[Threshold]:
    """The four thresholds in use: of the settings ``eval``, and the radius (m) within which a contact counts."""
    return [
        Threshold("formation", "FM", "m", float(evaluation["formation_threshold"])),
        Threshold("flight", "time to the goal", "s", float(evaluation["time_limit"])),
        Threshold("obstacle", "least clearance", "m", hit_radius),
        Threshold("action", "throttle change", "", float(evaluation["action_threshold"])),
    ]


def satisfied(rows: "pd.DataFrame", moved: Threshold) -> np.ndarray:
    """Whether each episode satisfies all four objectives with one threshold moved. Rows as in ``docs/rows.md``.

    The flight limit can only be tightened and the clearance only be widened: an episode was judged up to its end.
    """
    holds = {name: rows[f"ok_{name}"].to_numpy(bool) for name in ("formation", "flight", "obstacle", "action")}
    if moved.objective == "formation":
        holds["formation"] = rows["fm"].to_numpy(float) < moved.value
    elif moved.objective == "action":
        holds["action"] = rows["throttle_change"].to_numpy(float) < moved.value
    elif moved.objective == "flight":
        holds["flight"] = holds["flight"] & (rows["time_to_goal"].to_numpy(float) <= moved.value + 1e-6)
    else:
        clearance = rows[["min_column", "min_ball", "min_drone"]].min(axis=1).fillna(np.inf).to_numpy(float)
        holds["obstacle"] = holds["obstacle"] & (clearance >= moved.value)
    return np.logical_and.reduce(list(holds.values()))


def values(threshold: Threshold) -> list[float]:
    """Values that a threshold is moved through, the one in use among them."""
    if threshold.objective == "flight":
        factors: Sequence[float] = (0.7, 0.8, 0.9, 1.0)
    elif threshold.objective == "obstacle":
        factors = (1.0, 1.2, 1.4, 1.7, 2.0)
    else:
        factors = FACTORS
    return [threshold.value * factor for factor in factors]


def sweep(rows: Mapping[int, "pd.DataFrame"], thresholds: Sequence[Threshold]) -> "pd.DataFrame":
    """SR of every trial at every value: objective, unit, threshold, in_use, trial, sr. rows: trial -> its episodes."""
    import pandas as pd

    found = [
        {
            "objective": threshold.objective,
            "quantity": threshold.quantity,
            "unit": threshold.unit,
            "threshold": value,
            "in_use": value == threshold.value,
            "trial": trial,
            "sr": float(satisfied(episodes, Threshold(threshold.objective, "", "", value)).mean()),
        }
        for threshold in thresholds
        for value in values(threshold)
        for trial, episodes in rows.items()
    ]
    return pd.DataFrame(found)


def winners(table: "pd.DataFrame") -> "pd.DataFrame":
    """Per objective and threshold: the trial of highest SR, its SR and the median SR.

    Of equals the one wins that ``sweep`` was given first.
    """
    import pandas as pd

    found = []
    keys = ["objective", "quantity", "unit", "threshold", "in_use"]
    for key, group in table.groupby(keys, sort=False):
        best = group.sort_values("sr", ascending=False, kind="stable").iloc[0]
        found.append(
            dict(zip(keys, key, strict=True))
            | {"trial": int(best["trial"]), "sr": best["sr"], "median": group["sr"].median()}
        )
    return pd.DataFrame(found)
