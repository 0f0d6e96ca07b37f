"""Whether a run's files are what they were when they were written: hashes of checkpoints, rows, banks and studies."""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

from formctl.store import Run
from formctl.store.files import StoreError, read_json, read_lines

KEY = ["method", "seed", "run", "bank", "scenario_id"]
"""What tells two rows of an evaluation apart."""


def problems(run: Run) -> Iterator[tuple[Path, str]]:
    """Every damaged file of a run, its trials included, and what is wrong with it."""
    for path in files(run):
        try:
            CHECKS[path.suffix](path)
        except ValueError as error:
            yield path, " ".join(str(error).replace(f"{path} ", "").split())
    if (run.path / "study.db").exists():
        yield from absent(run)


def files(run: Run) -> list[Path]:
    """The files of a run that can be checked."""
    return sorted(path for path in run.path.rglob("*") if path.suffix in CHECKS and path.is_file())


def absent(run: Run) -> Iterator[tuple[Path, str]]:
    """Policies that the study's table names and that are not there."""
    from formctl.search.trials import read_table

    try:
        table = read_table(run.path)
    except StoreError as error:
        yield run.path / "study.db", str(error)
        return
    for policy in table.loc[table["state"] == "done", "policy"].dropna():
        if not (run.path / policy).is_file():
            yield run.path / policy, "is missing, though its trial is done"


def _checkpoint(path: Path) -> None:
    from algos import checkpoint

    checkpoint.load(path, kind="policy" if path.name == "policy.pt" else "training")


def _bank(path: Path) -> None:
    from envs.bank import Bank

    bank = Bank.load(path)
    recorded = read_json(path.parent / "run.json").get("bank") if (path.parent / "run.json").exists() else None
    if isinstance(recorded, dict) and recorded.get("sha256") not in (None, bank.sha256):
        raise StoreError("is another bank than the one on record")


def _table(path: Path) -> None:
    from formctl.evaluation.rows import read_rows

    rows = read_rows(path)
    if set(KEY) <= set(rows.columns) and (twice := int(rows.duplicated(KEY).sum())):
        raise StoreError(f"has {twice} rows twice")


def _lines(path: Path) -> None:
    read_lines(path)


def _settings(path: Path) -> None:
    if path.name == "config.yaml":
        assert Run(path.parent).config is not None


def _record(path: Path) -> None:
    read_json(path)


def _database(path: Path) -> None:
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=30)) as connection:
            (verdict,) = connection.execute("PRAGMA quick_check").fetchone()
    except sqlite3.Error as error:
        raise StoreError(str(error)) from error
    if verdict != "ok":
        raise StoreError(str(verdict))


CHECKS: dict[str, Callable[[Path], None]] = {
    ".pt": _checkpoint,
    ".npz": _bank,
    ".parquet": _table,
    ".jsonl": _lines,
    ".yaml": _settings,
    ".json": _record,
    ".db": _database,
}
