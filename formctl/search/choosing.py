"""What a study says: how far it is, which trials are best, and how good the winner is on episodes it was not chosen on.

The highest of many noisy rates is too high: the winner was lucky as well as good. It is flown on a bank of its own, and
both rates are shown.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from envs.vocabulary import OBJECTIVES
from formctl import store
from formctl.search import overview, storage
from formctl.search.ledger import Ledger
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from formctl.search.study import Study
    from formctl.settings import Config

Row = Mapping[str, Any]
"""A trial as ``overview`` gives it."""

SHOWN = 5
"""Trials in a list that nobody asked a length for."""


def find(words: Sequence[str], address: str | None) -> tuple[str, store.Run | None, Ledger]:
    """The study that the words of a call mean, without composing the settings: name, run folder here, database.

    Raises StoreError: no such study, or one whose database needs an address.
    """
    given = dict(word.split("=", 1) for word in words if "=" in word)
    name = given.get("name") or given.get("search.name") or given.get("search") or "stage1"
    root, url = Path(given.get("runs", "runs")), storage.given(address)
    if url is not None and store.latest(root, "search", name) is None:
        return name, None, Ledger(url, name)
    run = store.resolve(name, root, kind="search")
    return run.path.parent.name, run, ledger(run, url)


def ledger(run: store.Run, url: Any = None) -> Ledger:
    """The database of a search run. Raises StoreError where its address is not known or not the one given."""
    recorded = run.record.get("storage")
    if recorded is None:
        path = run.path / "study.db"
        if url is not None:
            raise StoreError(f"{run.path} keeps its study in {path.name}: leave out --storage, or type name=NAME")
        if not path.is_file():
            raise StoreError(f"{path} does not exist; `formctl search` makes a study")
        return Ledger(storage.sqlite(path))
    if url is None and "***" in recorded:
        raise StoreError(f"{run.path} keeps its study in {recorded}: give --storage or set {storage.VARIABLE}")
    return Ledger(url or storage.read(recorded), run.path.parent.name)


def show_status(name: str, run: store.Run | None, study: Ledger, total: int | None = None) -> None:
    """How far the study is: who works on what, what failed, what is best so far."""
    from formctl import console

    counts = overview.counts(study)
    total = total or int(study.facts.get("trials") or (run.record["budget"]["trials"] if run else sum(counts.values())))
    finished = counts["done"] + counts["failed"] + counts["pruned"]
    parts = [f"{counts[state]} {state}" for state in ("failed", "pruned") if counts[state]]
    some = f" ({', '.join(parts)})" if parts else ""
    where = run.path if run else f"{name} in {storage.shown(study.url)}"
    console.say(f"study {where}: {finished} of {total} done{some}, {max(0, total - finished)} to go")
    if lost := overview.losses(study):
        console.say(f"workers lost in the middle of a trial: {lost}")
    if at_work := overview.working(study):
        columns = ("trial", "steps", "worker", "last sign of life", "workers lost")
        console.table(columns, [(w.trial, f"{w.steps:,}", *who(w), w.losses) for w in at_work])
    for trial, reason in overview.failures(study, SHOWN):
        console.say(f"trial {trial} failed: {reason}")
    if counts["done"]:
        show_top(study, SHOWN)
        show_best(name, overview.top(study, 1)[0])


def who(working: overview.Working) -> tuple[str, str]:
    """Who works on a trial, and since when nothing was heard of them."""
    if working.host is None:
        return "nobody", ""
    return f"{working.host}, process {working.process}", f"{working.silent:.0f} s ago"


def show_top(study: Ledger, count: int) -> None:
    """The best trials. Raises StoreError when none is done."""
    from formctl import console

    rows = overview.top(study, count)
    if not rows:
        raise StoreError("no trial of the study is done yet; `formctl search --status` shows how far it is")
    columns = ("trial", *OBJECTIVES, "SR", *(f"ok {name}" for name in OBJECTIVES), "CFR", "FM", "minutes")
    console.table(columns, [cells(row) for row in rows])


def cells(row: Row) -> list[str]:
    """A trial as a line of the table."""
    weights = [f"{row[f'w_{name}']:.3f}" for name in OBJECTIVES]
    figures = [*(f"ok_{name}" for name in OBJECTIVES), "cfr", "fm", "minutes"]
    known = ["" if row.get(key) is None else f"{row[key]:.3f}" for key in figures]
    return [str(row["trial"]), *weights, rate(row, "sr"), *known]


def rate(row: Row, key: str) -> str:
    """``0.833 (167 of 200)``."""
    return f"{row[key]:.3f} ({row[f'{key}_k']} of {row[f'{key}_n']})"


def show_best(name: str, row: Row) -> None:
    """The best trial with both its rates, and how to take it on."""
    from formctl.console import say

    vector = ", ".join(f"{objective} {row[f'w_{objective}']:.4f}" for objective in OBJECTIVES)
    say(f"best: trial {row['trial']}, SR {rate(row, 'sr')}, weights {vector}")
    if row.get("sr_fresh") is not None:
        say(f"  on a fresh bank, which it was not chosen on: SR {rate(row, 'sr_fresh')}; this one is not flattered")
    say(f"take it on: formctl train weights=@{name}/best")


def confirm(study: "Study", config: "Config") -> Row | None:
    """Fly the best trial on a bank of its own and note its rate, unless that is known; returns its row.

    ``config`` is a trial's. None while no trial is done. Where its policy is on another host, that is said instead.
    """
    from formctl import console

    rows = overview.top(study.ledger, 1)
    if not rows:
        return None
    row, wanted = rows[0], config.search.fresh_episodes
    if row.get("sr_fresh_n") == wanted:
        return row
    policy = study.folder / str(row["policy"])
    if not policy.is_file():
        console.warn(f"trial {row['trial']} is not flown again: its policy is on {row.get('host')}, not in {policy}")
        return row
    console.say(f"flying the winner, trial {row['trial']}, on {wanted} fresh episodes")
    study.note(row["trial_id"], **fresh(policy, config))
    study.write_table()
    return overview.top(study.ledger, 1)[0]


def fresh(policy: Path, config: "Config") -> dict[str, Any]:
    """SR of a policy on the fresh bank; its rows stay beside it in ``fresh.parquet``."""
    from envs.bank import Bank
    from formctl.evaluation import methods
    from formctl.evaluation.evaluate import evaluate
    from formctl.evaluation.rows import rates, write_rows
    from formctl.evaluation.scenes import EvaluationScene
    from formctl.settings import build

    seed = build.held_out_seed(config.seed, "fresh")
    scene = EvaluationScene(build.world(config), Bank.create(config.scenario, config.search.fresh_episodes, seed))
    rows = evaluate(methods.policy(str(policy), config.runs), [scene], config)
    write_rows(policy.with_name("fresh.parquet"), rows)
    figures = rates(rows)
    return {"sr_fresh": figures["sr"], "sr_fresh_k": figures["sr_k"], "sr_fresh_n": figures["sr_n"]}
