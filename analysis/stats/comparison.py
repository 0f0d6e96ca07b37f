"""Two methods on the same episodes, from anybody's rows: rates, an exact paired test, a difference with its interval.

A row needs ``scenario_id`` and a flag (``cfr``); where both sides have them, the columns of ``PLACE`` and ``seed`` say
which episodes are the same. The statistics are those of the report's paired table.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from analysis.stats.intervals import Mean, Rate, rate
from analysis.stats.paired import mcnemar, paired_difference, paired_rate_difference

PLACE = ("scenario", "columns", "balls", "ball_aim", "drones", "sim", "drone", "deploy")
"""Columns that tell scenes apart; those that only one side has, or that name its own world, do not hinder pairing."""


class ComparisonError(ValueError):
    """Rows that cannot be read or paired; one line."""


@dataclass(frozen=True)
class Side:
    """One method's rows. ``name`` is the method's, or the file's where the rows do not say."""

    name: str
    rows: pd.DataFrame


@dataclass(frozen=True)
class Comparison:
    """What shared episodes say about B against A; differences are B minus A."""

    first: Rate
    second: Rate
    shared: int  # pairs of episodes
    left_out: int  # episodes of either side that the other does not have
    only_first: int  # pairs in which only A succeeded
    only_second: int
    p: float  # exact McNemar, two-sided; of several seeds the weakest, 1 where they disagree on who is better
    difference: Mean
    fm: Mean | None  # m, over the pairs in which both succeeded; None without any, or without ``fm``

    def worse(self, margin: float) -> bool:
        """Whether B's rate on the shared episodes is below A's by more than ``margin``."""
        return self.difference.value < -margin - 1e-12


def read(path: Path, flag: str = "cfr", method: str | None = None) -> Side:
    """Rows of one method from Parquet or CSV, by the file's ending. Raises ComparisonError."""
    if not path.is_file():
        raise ComparisonError(f"there is no file {path}")
    try:
        rows = pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)
    except (OSError, ValueError) as error:
        said = " ".join(str(error).split())[:120]
        raise ComparisonError(
            f"{path} cannot be read as {'CSV' if path.suffix == '.csv' else 'Parquet'}: {said}"
        ) from error
    for column in ("scenario_id", flag):
        if column not in rows:
            raise ComparisonError(f"{path} has no column {column!r}; its columns are {', '.join(map(str, rows))[:160]}")
    names = sorted(rows["method"].astype(str).unique()) if "method" in rows else []
    if method is not None:
        if method not in names:
            raise ComparisonError(
                f"{path} has no rows of {method!r}; its methods are {', '.join(names) or 'not named'}"
            )
        rows, names = rows[rows["method"].astype(str) == method], [method]
    if len(names) > 1:
        raise ComparisonError(f"{path} holds {', '.join(names)}: choose one with {path}:METHOD")
    if rows.empty:
        raise ComparisonError(f"{path} holds no episodes")
    return Side(names[0] if names else path.stem, rows.assign(**{flag: _flags(rows[flag], path, flag)}))


def compare(first: Side, second: Side, flag: str = "cfr", across_banks: bool = False) -> Comparison:
    """B (``second``) against A (``first``) on the episodes that both flew. Raises ComparisonError where there is none.

    ``across_banks`` pairs equal numbers of different banks, which is right where both were drawn from one seed.
    """
    keys = _keys(first.rows, second.rows)
    if "bank" in keys and across_banks:
        keys.remove("bank")
    pairs = _paired(first, second, keys, flag)
    if pairs.empty:
        hint = ""
        if "bank" in keys and not set(first.rows["bank"]) & set(second.rows["bank"]):
            hint = ": their banks differ; --across-banks pairs them where both were drawn from one seed"
        raise ComparisonError(f"{first.name} and {second.name} share no episode{hint}")
    tests = [mcnemar(own[f"{flag}_a"], own[f"{flag}_b"]) for _, own in pairs.groupby("pair")]
    signs = {(test.only_a > test.only_b) - (test.only_a < test.only_b) for test in tests}
    change = pairs.assign(value=pairs[f"{flag}_b"].astype(float) - pairs[f"{flag}_a"].astype(float))
    difference = paired_rate_difference(_matrix(change, keys))
    assert difference is not None
    return Comparison(
        first=_rate(pairs, f"{flag}_a", "seed_a", keys),
        second=_rate(pairs, f"{flag}_b", "seed_b", keys),
        shared=len(pairs),
        left_out=_alone(first.rows, second.rows, keys),
        only_first=sum(test.only_a for test in tests),
        only_second=sum(test.only_b for test in tests),
        p=max(test.p for test in tests) if len(signs) == 1 else 1.0,
        difference=difference,
        fm=_fm(pairs, flag, keys),
    )


def _flags(values: pd.Series, path: Path, flag: str) -> pd.Series:
    """A column of true and false, or of 0 and 1, as booleans."""
    numbers = values.replace({"True": True, "False": False, "true": True, "false": False})
    odd = [value for value in numbers.unique().tolist() if value not in (0, 1)]
    if odd:
        raise ComparisonError(f"{path}: column {flag!r} holds {odd[0]!r}, but flags are true or false")
    return numbers.astype(bool)


def _keys(first: pd.DataFrame, second: pd.DataFrame) -> list[str]:
    """Columns that say which episode a row is: those of both sides, where they have any value in common."""
    shared = [column for column in ("bank", *PLACE) if column in first and column in second]
    return [*shared, "scenario_id"]


def _paired(first: Side, second: Side, keys: list[str], flag: str) -> pd.DataFrame:
    """One row a pair: n-th seed against n-th, a single seed against all of the other's."""
    sides = [_numbered(side, keys, flag) for side in (first, second)]
    seeds = [sorted(rows["seed"].unique()) for rows in sides]
    count = max(map(len, seeds)) if min(map(len, seeds)) == 1 else min(map(len, seeds))
    parts = []
    for n in range(count):
        own = [rows[rows["seed"] == known[n % len(known)]] for rows, known in zip(sides, seeds, strict=True)]
        parts.append(own[0].merge(own[1], on=keys, suffixes=("_a", "_b")).assign(pair=n))
    joined: pd.DataFrame = pd.concat(parts, ignore_index=True)
    return joined


def _numbered(side: Side, keys: list[str], flag: str) -> pd.DataFrame:
    """The columns that are paired; empty texts are equal however they were stored. ComparisonError for repetitions."""
    rows = side.rows.assign(seed=side.rows.get("seed", 0))
    texts = {
        key: rows[key].astype("string").fillna("") for key in keys if key not in ("scenario_id", "columns", "balls")
    }
    rows = rows.assign(**texts)
    repeated = rows.duplicated([*keys, "seed"])
    if repeated.any():
        number = rows.loc[repeated, "scenario_id"].iloc[0]
        raise ComparisonError(f"{side.name}: episode {number} stands there more than once")
    wanted = [*keys, "seed", flag, *(["fm"] if "fm" in rows else [])]
    return rows[wanted]


def _matrix(pairs: pd.DataFrame, keys: Sequence[str]) -> np.ndarray:
    """``value`` as (seeds, episodes)."""
    return pairs.pivot(index="pair", columns=list(keys), values="value").to_numpy(float)


def _rate(pairs: pd.DataFrame, flag: str, seed: str, keys: Sequence[str]) -> Rate:
    """A side's rate on the shared episodes, each counted once however many seeds of the other it meets."""
    own = pairs.drop_duplicates([*keys, seed])
    return rate(own[flag].to_numpy(bool), own[seed].to_numpy())


def _fm(pairs: pd.DataFrame, flag: str, keys: Sequence[str]) -> Mean | None:
    if "fm_a" not in pairs:
        return None
    both = pairs[f"{flag}_a"] & pairs[f"{flag}_b"]
    return paired_difference(_matrix(pairs.assign(value=(pairs["fm_b"] - pairs["fm_a"]).where(both)), keys))


def _alone(first: pd.DataFrame, second: pd.DataFrame, keys: Sequence[str]) -> int:
    """Episodes that only one side has."""
    ours, theirs = (
        set(map(tuple, rows[list(keys)].astype("string").fillna("").drop_duplicates().to_numpy().tolist()))
        for rows in (first, second)
    )
    return len(ours ^ theirs)
