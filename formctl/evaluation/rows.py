"""Rows of an evaluation: their file, and the few figures that are printed and recorded with a run."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from envs.vocabulary import CONTACTS, FAILURES, OBJECTIVES
from formctl.store.files import StoreError, atomic


def write_rows(path: Path, rows: pd.DataFrame) -> None:
    """Rows as Parquet, atomically; equal rows give equal bytes.

    Numbers that a float32 world computed are half zeros: split into byte streams they shrink to 60 % of that.
    """
    numbers = [str(name) for name, kind in rows.dtypes.items() if kind == np.float64]
    others = [str(name) for name in rows if name not in numbers]
    small: dict[str, Any] = {"compression": "zstd", "compression_level": 9, "store_schema": False}
    with atomic(path) as temporary:
        rows.to_parquet(temporary, index=False, use_dictionary=others, use_byte_stream_split=numbers, **small)


def read_rows(path: Path) -> pd.DataFrame:
    """Rows of an evaluation. Raises StoreError where there are none."""
    try:
        return pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} cannot be read: {str(error).splitlines()[0]}") from error


def rates(rows: pd.DataFrame) -> dict[str, Any]:
    """What a search keeps of an evaluation: SR with k of n, CFR, FM of successes, throttle change, four rates."""
    figures: dict[str, Any] = {"sr": float(rows["sr"].mean()), "sr_k": int(rows["sr"].sum()), "sr_n": len(rows)}
    figures |= {"cfr": float(rows["cfr"].mean()), "fm": mean_fm(rows)}
    figures["throttle_change"] = float(rows["throttle_change"].mean())
    return figures | {f"ok_{name}": float(rows[f"ok_{name}"].mean()) for name in OBJECTIVES}


def failure_reasons(rows: pd.DataFrame) -> list[tuple[str, int, int]]:
    """Why episodes failed: (reason, episodes, row number of the first), by first cause in the order of FAILURES.

    The planner stands last: among those failed episodes are some in which it could not do its work.
    """
    failed = rows[rows["failure"] != ""]
    parts = [(cause, failed[failed["failure"] == cause]) for cause in FAILURES]
    if "planner_failures" in rows:  # rows of earlier versions do not have it
        stuck = failed[failed["planner_failures"] > 0]
        commonest = stuck["planner_reason"].value_counts(sort=True)
        parts.append((f"of these, planner ({commonest.index[0]})" if len(stuck) else "planner", stuck))
    return [(reason, len(part), int(part.index[0])) for reason, part in parts if len(part)]


def mean_fm(rows: pd.DataFrame) -> float | None:
    """FM in m over the collision-free episodes that reached the goal (paper, Sec. VI-A1); None where there is none."""
    flown = rows.loc[rows["cfr"], "fm"]
    return None if flown.empty else float(flown.mean())


def selection_score(rows: pd.DataFrame) -> dict[str, float]:
    """Figures by which policies of one training are compared; ``score`` decides.

    CFR counts; where it is equal (at first it is 0) the share of episodes without a collision does, then FM.
    """
    clear = float((~rows["failure"].isin(CONTACTS)).mean())
    cfr, fm = float(rows["cfr"].mean()), float(rows["fm"].mean())
    fm = fm if np.isfinite(fm) else 1e9
    total = cfr + 0.01 * clear + 0.001 / (1 + fm)
    return {"score": total, "cfr": cfr, "collision_free": clear, "fm": fm, "sr": float(rows["sr"].mean())}
