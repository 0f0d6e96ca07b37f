"""Whether runs are what they were when they were written: their files read, rows of published stores flown again."""

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

from algos import checkpoint
from analysis.data.text import counted
from envs.bank import Bank
from formctl import store
from formctl.console import say, table
from formctl.errors import RunFailed
from formctl.evaluation import reverify
from formctl.evaluation.rows import read_rows
from formctl.search.table import read_table
from formctl.stages import runs as runs_stage
from formctl.store import Run, manifest
from formctl.store.files import StoreError, read_json, read_lines

KEY = ["method", "seed", "run", "bank", "scenario_id"]
"""What tells two rows of an evaluation apart."""


def verify_runs(texts: Sequence[str], root: Path, seconds: float = 60.0) -> None:
    """Check the files of runs, or of every run of the store; a published store also against its manifest.

    Rows of a published store are flown again, none begun after ``seconds``. Raises RunFailed for anything damaged.
    """
    stores = {text: folder for text in texts if (folder := published(text, root)) is not None}
    runs = [store.resolve(text, root) for text in texts if text not in stores]
    runs += [run for folder in (stores.values() if texts else [root]) for run in store.scan(folder)]
    if not runs:
        say(runs_stage.nothing(root))
        return
    count = sum(len(files(run)) for run in runs)
    damaged = [problem for run in runs for problem in problems(run)]
    damaged += [difference for folder in stores.values() for difference in manifest.differences(folder)]
    for path, what in damaged:
        say(f"{path}: {what}")
    checked = f"{counted(count, 'file')} in {counted(len(runs), 'run')}"
    if damaged:
        raise RunFailed(f"{len(damaged)} of {checked} {'is' if len(damaged) == 1 else 'are'} damaged or missing")
    say(f"{checked} {'is' if count == 1 else 'are'} whole")
    for folder in stores.values():
        say(f"{folder}: as published ({manifest.text(folder)})")
        fly_again(folder, seconds)


def fly_again(folder: Path, seconds: float) -> None:
    """Fly a sample of a published store's rows. Raises RunFailed where one is not what it was."""
    outcomes = list(reverify.sample(folder, seconds))
    lines = [(o.method, o.run.id, o.rows, o.equal, f"{o.difference:.2g}", o.verdict) for o in outcomes]
    columns = ("method", "evaluation", "rows flown again", "the same bits", "largest difference", "verdict")
    table(columns, lines)
    reverify.refuse(outcomes)
    if wrong := [outcome for outcome in outcomes if outcome.wrong]:
        raise RunFailed(f"{len(wrong)} of {len(outcomes)} evaluations could not be confirmed: {wrong[0].wrong}")
    total, same = sum(o.rows for o in outcomes), sum(o.equal for o in outcomes)
    apart = sum(bool(outcome.apart) for outcome in outcomes)
    rest = f"all confirmed but for {apart} that only their own processor repeats" if apart else "all confirmed"
    say(f"{total} rows of {len(outcomes)} evaluations flown again: {same} with the same bits, {rest}")


def published(text: str, place: Path) -> Path | None:
    """The published store that ``text`` names, by its path or inside the store; None where it names none."""
    return next((root for root in (place / text, Path(text)) if (root / manifest.NAME).is_file()), None)


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
    try:
        trials = read_table(run.path)
    except StoreError as error:
        yield run.path / "study.db", str(error)
        return
    for policy in trials.loc[trials["state"] == "done", "policy"].dropna():
        if not (run.path / policy).is_file():
            yield run.path / policy, "is missing, though its trial is done"


def _checkpoint(path: Path) -> None:
    checkpoint.load(path, kind="policy" if path.name == "policy.pt" else "training")


def _bank(path: Path) -> None:
    bank = Bank.load(path)
    if path.name != "bank.npz":  # a search's fresh episodes have a bank of their own
        return
    recorded = read_json(path.parent / "run.json").get("bank") if (path.parent / "run.json").exists() else None
    if isinstance(recorded, dict) and recorded.get("sha256") not in (None, bank.sha256):
        raise StoreError("is another bank than the one on record")


def _table(path: Path) -> None:
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
