"""What a study says on the terminal: how far it is, which trials are best, and how to take the winner on."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy

from envs.vocabulary import OBJECTIVES
from formctl import store
from formctl.console import say
from formctl.console import table as print_table
from formctl.search import database, table, winner
from formctl.search.leases import OPEN, TRIALS, Leases
from formctl.search.table import Row
from formctl.store.files import StoreError

SHOWN = 5
"""Trials in a list that nobody asked a length for."""


@dataclass(frozen=True)
class StudyView:
    """A study as whoever only reads it sees it: nothing is composed, made or changed for it."""

    name: str
    url: sqlalchemy.URL
    run: store.Run | None  # its folder, where that is on this host

    @classmethod
    def find(cls, words: Sequence[str], address: str | None) -> "StudyView":
        """The study that the words of a call mean. Raises StoreError: none, or one whose database needs an address."""
        given = dict(word.split("=", 1) for word in words if "=" in word)
        name = given.get("name") or given.get("search.name") or given.get("search") or "stage1"
        root, url = Path(given.get("runs", "runs")).expanduser(), database.given(address)
        if url is not None and store.latest(root, "search", name) is None:
            return cls(name, url, None)
        run = store.resolve(name, root, kind="search")
        return cls(run.path.parent.name, address_of(run, url), run)

    @property
    def folder(self) -> Path:
        """The study's folder. Raises StoreError where it is on other hosts only."""
        if self.run is None:
            raise StoreError(f"the policies of {self.name} are not on this host; --status and --top work everywhere")
        return self.run.path

    @property
    def study(self) -> str:
        """Its name in the database."""
        return table.NAME if self.url.drivername == "sqlite" else self.name

    def rows(self) -> list[Row]:
        """Its trials."""
        return table.ask(self.url, self.study, self.run.path if self.run else None)


def address_of(run: store.Run, url: sqlalchemy.URL | None = None) -> sqlalchemy.URL:
    """The database of a search run. Raises StoreError where its address is not known or not the one given."""
    recorded = run.record.get("storage")
    if recorded is None:
        path = run.path / "study.db"
        if url is not None:
            raise StoreError(f"{run.path} keeps its study in {path.name}: leave out --storage, or type name=NAME")
        if not path.is_file():
            raise StoreError(f"{path} does not exist; `formctl search` makes a study")
        return database.sqlite(path)
    if url is None and "***" in recorded:
        raise StoreError(f"{run.path} keeps its study in {recorded}: give --storage or set {database.VARIABLE}")
    return url or database.read(recorded)


def show_status(view: StudyView, total: int | None = None) -> None:
    """How far the study is: who works on what, what failed, what is best so far."""
    trials, leases = view.rows(), Leases(view.url, view.study)
    counts = {state: sum(row["state"] == state for row in trials) for state in ("done", "failed", "pruned", OPEN)}
    total = total or (view.run.record["budget"]["trials"] if view.run else len(trials))
    finished = counts["done"] + counts["failed"] + counts["pruned"]
    parts = [f"{counts[state]} {state}" for state in ("failed", "pruned") if counts[state]]
    some = f" ({', '.join(parts)})" if parts else ""
    where = view.run.path if view.run else f"{view.name} in {database.shown(view.url)}"
    say(f"study {where}: {finished} of {total} done{some}, {max(0, total - finished)} to go")
    if leases.exist():
        show_workers(leases)
    for row in [row for row in trials if row["state"] == "failed"][-SHOWN:]:
        say(f"trial {row['trial']} failed: {row['error'] or 'no reason on record'}")
    if counts["done"]:
        show_top(trials, SHOWN)
        show_best(view.name, trials)


def show_workers(leases: Leases) -> None:
    """Who works on which trial, since when nothing was heard of them, and how many were lost."""
    if lost := leases.losses():
        say(f"workers lost in the middle of a trial: {lost}")
    at_work = [
        (
            row.trial,
            f"{max(map(int, row.curve or {0: 0})):,}",
            f"{row.host}, process {row.process}" if row.token else "nobody",
            f"{row.silent:.0f} s ago" if row.token else "",
            row.losses,
        )
        for row in leases.rows(TRIALS.c.state == OPEN)
    ]
    if at_work:
        print_table(("trial", "steps", "worker", "last sign of life", "workers lost"), at_work)


def show_top(trials: Sequence[Row], count: int) -> None:
    """The trials of the highest SR. Raises StoreError when none is done."""
    columns = ("trial", *OBJECTIVES, "SR", *(f"ok {name}" for name in OBJECTIVES), "CFR", "FM", "minutes")
    print_table(columns, [cells(row) for row in winner.by_rate(trials)[:count]])


def cells(row: Row) -> list[str]:
    """A trial as a line of the table."""
    weights = [f"{row[f'w_{name}']:.3f}" for name in OBJECTIVES]
    figures = [*(f"ok_{name}" for name in OBJECTIVES), "cfr", "fm", "minutes"]
    known = ["" if row.get(key) is None else f"{row[key]:.3f}" for key in figures]
    return [str(row["trial"]), *weights, rate(row, "sr"), *known]


def show_best(name: str, trials: Sequence[Row]) -> None:
    """The winner with all its rates, why it was chosen, and how to take it on. Raises StoreError when none is done."""
    row, tied = winner.choose(trials), winner.not_told_apart(trials)
    vector = ", ".join(f"{objective} {row[f'w_{objective}']:.4f}" for objective in OBJECTIVES)
    say(f"winner: trial {row['trial']}, SR {rate(row, 'sr')}, weights {vector}")
    if len(tied) > 1:
        fm = "" if row["fm"] is None else f", {row['fm']:.3f} m"
        say(f"  of the {len(tied)} trials that are not told from the highest SR, the one of the lowest FM{fm}")
    for line in confirmations(row):
        say(f"  {line}")
    say(f"take it on: formctl train curriculum=three_period weights=@{name}/best")


def confirmations(row: Row) -> list[str]:
    """What is known of a trial beside the rate it was chosen by."""
    told = []
    if row.get("sr_fresh") is not None:
        told.append(
            f"on a fresh bank, which it was not chosen on: SR {rate(row, 'sr_fresh')}; this one is not flattered"
        )
    if row.get("sr_again") is not None:
        seeds = f"trained again with {row['seeds_again']} other seeds"
        told.append(f"{seeds}, on the fresh bank: SR {rate(row, 'sr_again')}")
    return told


def rate(row: Row, key: str) -> str:
    """``0.833 (167 of 200)``."""
    return f"{row[key]:.3f} ({row[f'{key}_k']} of {row[f'{key}_n']})"


def summary(trials: Sequence[Row]) -> dict[str, Any]:
    """Counts and the winner so far, for the run's record."""
    counts = {state: sum(row["state"] == state for row in trials) for state in ("done", "failed", "pruned", OPEN)}
    if not counts["done"]:
        return {**counts, "trial": None, "sr": None, "weights": None}
    row = winner.choose(trials)
    rates = {key: row[key] for key in ("sr", "sr_fresh", "sr_again") if row.get(key) is not None}
    return {**counts, "trial": row["trial"], **rates, "weights": list(table.weights(row))}
