"""Trials of a weight search: the law of their weights, and the table that everybody but the search itself reads."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from formctl import store
from formctl.store.files import StoreError

Weights = tuple[float, float, float, float]
"""Formation, flight, obstacle, action; on the simplex."""

PARAMETERS = ("w_formation", "w_flight", "w_obstacle", "w_action")

FIGURES = ("sr", "sr_k", "sr_n", "cfr", "fm", "throttle_change")
NUMBERS = (*FIGURES, "ok_formation", "ok_flight", "ok_obstacle", "ok_action")
COUNTS = ("sr_k", "sr_n", "sr_fresh_k", "sr_fresh_n")
COLUMNS: dict[str, str] = {
    "trial": "int64",
    "state": "str",
    **dict.fromkeys(PARAMETERS, "float64"),
    "seed": "Int64",
    "budget": "Int64",
    "steps": "Int64",
    "minutes": "Float64",
    **{name: "Int64" if name in COUNTS else "Float64" for name in (*NUMBERS, "sr_fresh", "sr_fresh_k", "sr_fresh_n")},
    "run": "str",
    "policy": "str",
    "host": "str",
    "error": "str",
}
"""Columns of ``trials.parquet``; what a trial does not know yet is null. ``sr_fresh`` is the re-evaluated winner's."""


def _dirichlet(seed: int, trial: int) -> np.ndarray:
    """Uniform on the simplex."""
    return _generator(seed, trial).dirichlet(np.ones(len(PARAMETERS)))


def _release(seed: int, trial: int) -> np.ndarray:
    """Four uniforms divided by their sum: what the authors' stage-1 script draws."""
    uniforms = _generator(seed, trial).uniform(size=len(PARAMETERS))
    return np.asarray(uniforms / uniforms.sum())


def _sobol(seed: int, trial: int) -> np.ndarray:
    """Point ``trial`` of a scrambled Sobol sequence, carried to the simplex: it fills more evenly than chance does."""
    from scipy.stats import qmc

    sequence = qmc.Sobol(len(PARAMETERS) - 1, scramble=True, rng=np.random.default_rng(np.random.SeedSequence([seed])))
    if trial:
        sequence.fast_forward(trial)
    return simplex(sequence.random(1)[0])


def _generator(seed: int, trial: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence([seed, trial]))


RULES: dict[str, Callable[[int, int], np.ndarray]] = {"dirichlet": _dirichlet, "release": _release, "sobol": _sobol}
"""Weights from (study seed, trial number) alone."""

GUIDED = ("tpe", "cmaes", "nsga2")
"""Optuna's own samplers: what they propose depends on the trials that are finished by then."""


def simplex(unit: np.ndarray) -> np.ndarray:
    """A point of the unit cube (n,) as a point of the simplex (n + 1,); uniform goes to uniform (stick-breaking)."""
    rest, parts = 1.0, []
    for left, share in zip(range(len(unit), 0, -1), unit, strict=True):
        kept = (1.0 - share) ** (1.0 / left)
        parts.append(rest * (1.0 - kept))
        rest *= kept
    return np.array([*parts, rest])


def weights(seed: int, trial: int, rule: str) -> Weights:
    """Weights of trial ``trial`` in the order formation, flight, obstacle, action; they sum to 1.

    Raises StoreError for an unknown rule.
    """
    if rule not in RULES:
        raise StoreError(f"search.sampler={rule} is unknown; choose one of: {', '.join((*RULES, *GUIDED))}")
    formation, flight, obstacle, action = (float(value) for value in RULES[rule](seed, trial))
    return formation, flight, obstacle, action


def read_table(folder: Path) -> pd.DataFrame:
    """The trials of a search run: ``trials.parquet``, or the database in the folder where that knows more.

    Raises StoreError where there is neither.
    """
    path, database = folder / "trials.parquet", folder / "study.db"
    if database.exists() and not (path.exists() and path.stat().st_mtime_ns >= database.stat().st_mtime_ns):
        from formctl.search.study import Study

        return Study.open(folder).table()
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
