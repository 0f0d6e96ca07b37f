"""The table of a study's trials: what the database says, kept in ``trials.parquet`` for everybody who reads it.

The database is the truth. Of the file only those rows are taken that the database has finished under the same number; a
damaged one is made anew.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyarrow import parquet
from sqlalchemy import URL

from envs.vocabulary import OBJECTIVES, Weights
from formctl import store
from formctl.search import database
from formctl.search.laws import PARAMETERS
from formctl.search.leases import OPEN, Leases
from formctl.store import lock
from formctl.store.files import StoreError, atomic

if TYPE_CHECKING:
    import pandas as pd
    from optuna.trial import FrozenTrial

    from formctl.search.study import WeightStudy

NAME = "weights"
"""Name of a study in its own SQLite file."""

Row = dict[str, Any]
"""A trial: COLUMNS, what is not known of it None."""

NUMBERS = ("sr", "cfr", "fm", "throttle_change", *(f"ok_{name}" for name in OBJECTIVES), "sr_fresh", "sr_again")
COUNTS = ("seed", "budget", "steps", "sr_k", "sr_n", "sr_fresh_k", "sr_fresh_n", "number")
AGAIN = ("sr_again_k", "sr_again_n", "seeds_again")
TEXTS = ("episodes", "run", "policy", "host", "error")
COLUMNS: dict[str, str] = {
    "trial": "int64",
    "state": "str",
    **dict.fromkeys(PARAMETERS, "float64"),
    **dict.fromkeys((*COUNTS, *AGAIN), "Int64"),
    **dict.fromkeys((*NUMBERS, "minutes"), "Float64"),
    **dict.fromkeys(TEXTS, "str"),
}
"""Columns of ``trials.parquet``. ``episodes`` has a bit for each episode of the bank, the first one highest, in
hexadecimal digits: 1 where it satisfied all objectives; ``sr_fresh`` is the winner's on episodes of
their own, ``sr_again`` that of the best trials trained once more."""

STATES = {"COMPLETE": "done", "FAIL": "failed", "PRUNED": "pruned", "RUNNING": OPEN, "WAITING": OPEN}
"""Optuna's states of a trial and ours."""


def rows(folder: Path | None, leases: Leases, read: Callable[[int], Row]) -> list[Row]:
    """The trials of a study by index; ``read`` asks Optuna for the one of a number, and raises KeyError past the last.

    ``folder`` is the run's, where it is on this host. A study of an earlier version has no leases: its file is taken,
    or all that Optuna has.
    """
    cached = _read(folder / "trials.parquet") if folder else {}
    if not leases.exist():
        return list(cached.values()) or _all(read)
    found = []
    for lease in leases.rows():
        known = cached.get(lease.trial, {})
        if lease.state == OPEN:
            known = dict(zip(PARAMETERS, lease.weights or (None,) * len(PARAMETERS), strict=True))
        elif (known.get("number"), known.get("state")) != (lease.number, lease.state):
            known = read(lease.number)
        own = {"trial": lease.trial, "state": lease.state, "number": lease.number}
        found.append(dict.fromkeys(COLUMNS) | known | (lease.notes or {}) | own)
    return found


def row(trial: "FrozenTrial") -> Row:
    """What Optuna keeps of a trial."""
    own = {"trial": trial.number, "state": STATES[trial.state.name], "number": trial.number}
    return dict.fromkeys(COLUMNS) | own | trial.params | trial.user_attrs


def write(folder: Path, trials: list[Row]) -> None:
    """Replace ``trials.parquet``."""
    path = folder / "trials.parquet"
    with lock.hold(folder / "trials.lock", patience=30), atomic(path) as temporary:
        frame(trials).to_parquet(temporary, index=False)


def frame(trials: list[Row]) -> "pd.DataFrame":
    """The trials as a data frame of COLUMNS."""
    import pandas as pd  # takes a second, and telling how a study stands does without

    return pd.DataFrame(trials, columns=list(COLUMNS)).astype(COLUMNS)


def read_rows(folder: Path) -> list[Row]:
    """The trials of a search run: what the database in its folder says, or its file where the database is elsewhere.

    Raises StoreError where there is neither.
    """
    path = folder / "study.db"
    if path.is_file():
        return ask(database.sqlite(path), NAME, folder)
    found = list(_read(folder / "trials.parquet").values())
    if not found:
        raise StoreError(f"{folder} has no study: neither study.db nor trials.parquet can be read")
    return found


def ask(url: URL, study: str, folder: Path | None) -> list[Row]:
    """The trials of the study of that name in the database at ``url``."""

    @cache
    def opened() -> "WeightStudy":
        from formctl.search.study import WeightStudy, known  # bring Optuna, only asked for what the file lacks

        names = known(url)  # an earlier version gave the one study of a file another name
        return WeightStudy(folder or Path(), url, names[0] if len(names) == 1 else study)

    return rows(folder, Leases(url, study), lambda number: opened().read(number))


def read_table(folder: Path) -> "pd.DataFrame":
    """``read_rows`` as a data frame."""
    return frame(read_rows(folder))


def weights(trial: Row) -> Weights:
    """The weight vector of a row."""
    formation, flight, obstacle, action = (float(trial[name]) for name in PARAMETERS)
    return formation, flight, obstacle, action


def split_reference(reference: str, root: Path) -> tuple[store.Run, str]:
    """The search run and the choice within it that ``STUDY/best`` names. Raises StoreError."""
    study, slash, which = reference.rpartition("/")
    if not slash:
        raise StoreError(f"weights=@{reference} names no trial; type weights=@{reference}/best or .../trial=NUMBER")
    return store.resolve(study, root, kind="search"), which


def _all(read: Callable[[int], Row]) -> list[Row]:
    found: list[Row] = []
    while True:
        try:
            found.append(read(len(found)))
        except KeyError:
            return found


def _read(path: Path) -> dict[int, Row]:
    """The rows of the file by index; none where it is missing or damaged."""
    try:
        return {row["trial"]: dict.fromkeys(COLUMNS) | row for row in parquet.read_table(path).to_pylist()}
    except (OSError, ValueError, KeyError):
        return {}
