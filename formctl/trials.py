"""Trials of a weight search: the law of their weights, and the table that everybody but the search itself reads."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from formctl import store
from formctl.files import StoreError

Weights = tuple[float, float, float, float]
"""Formation, flight, obstacle, action; on the simplex."""

PARAMETERS = ("w_formation", "w_flight", "w_obstacle", "w_action")
RULES: dict[str, Callable[[np.random.Generator], np.ndarray]] = {}

NUMBERS = ("sr", "sr_k", "sr_n", "cfr", "fm", "ok_formation", "ok_flight", "ok_obstacle", "ok_action")
COLUMNS: dict[str, str] = {
    "trial": "int64",
    "state": "str",
    **dict.fromkeys(PARAMETERS, "float64"),
    "seed": "Int64",
    "steps": "Int64",
    "minutes": "Float64",
    **{name: "Int64" if name in ("sr_k", "sr_n") else "Float64" for name in NUMBERS},
    "policy": "str",
    "error": "str",
}
"""Columns of ``trials.parquet``; what a trial does not know yet is null."""


def _dirichlet(generator: np.random.Generator) -> np.ndarray:
    """Uniform on the simplex."""
    return generator.dirichlet(np.ones(len(PARAMETERS)))


def _release(generator: np.random.Generator) -> np.ndarray:
    """Four uniforms divided by their sum: what the authors' stage-1 script draws."""
    uniforms = generator.uniform(size=len(PARAMETERS))
    return np.asarray(uniforms / uniforms.sum())


RULES |= {"dirichlet": _dirichlet, "release": _release}


def weights(seed: int, trial: int, rule: str) -> Weights:
    """Weights of trial ``trial`` in the order formation, flight, obstacle, action; they sum to 1.

    Raises StoreError for an unknown rule.
    """
    if rule not in RULES:
        raise StoreError(f"search.sampler={rule} is unknown; choose one of: {', '.join(RULES)}")
    draw = RULES[rule](np.random.default_rng(np.random.SeedSequence([seed, trial])))
    formation, flight, obstacle, action = (float(value) for value in draw)
    return formation, flight, obstacle, action


def read_table(folder: Path) -> pd.DataFrame:
    """``trials.parquet`` of a search run. Raises StoreError where there is none."""
    path = folder / "trials.parquet"
    try:
        return pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} cannot be read: {str(error).splitlines()[0]}") from error


def best(table: pd.DataFrame) -> pd.Series:
    """The finished trial of highest SR; equal SR is decided by CFR, then lower FM, then lower number.

    Raises StoreError when no trial is done.
    """
    done = table[table["state"] == "done"]
    if done.empty:
        raise StoreError("no trial of the study is done yet; `formctl search --status` shows how far it is")
    order = ["sr", "cfr", "fm", "trial"]
    return done.sort_values(order, ascending=[False, False, True, True], na_position="last").iloc[0]


def select(table: pd.DataFrame, which: str) -> pd.Series:
    """The row that ``best`` or ``trial=K`` means. Raises StoreError for anything else."""
    if which == "best":
        return best(table)
    key, _, number = which.partition("=")
    if key != "trial" or not number.isdigit():
        raise StoreError(f"'{which}' is neither best nor trial=NUMBER")
    rows = table[table["trial"] == int(number)]
    if rows.empty:
        raise StoreError(f"the study has no trial {number}; its trials are 0 to {len(table) - 1}")
    return rows.iloc[0]


def row_weights(row: pd.Series) -> Weights:
    """The weight vector of a row of the table."""
    formation, flight, obstacle, action = (float(row[name]) for name in PARAMETERS)
    return formation, flight, obstacle, action


def resolve_weights(reference: str, root: Path) -> Weights:
    """Weights of ``STUDY/best`` or ``STUDY/trial=K``, STUDY being a name, id or path of a search run."""
    run, which = split_reference(reference, root)
    return row_weights(select(read_table(run.path), which))


def split_reference(reference: str, root: Path) -> tuple[store.Run, str]:
    """The search run and the choice within it that ``STUDY/best`` names. Raises StoreError."""
    study, slash, which = reference.rpartition("/")
    if not slash:
        raise StoreError(f"weights=@{reference} names no trial; type weights=@{reference}/best or .../trial=NUMBER")
    return store.resolve(study, root, kind="search"), which
