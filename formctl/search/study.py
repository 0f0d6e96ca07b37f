"""The weight search's record: an Optuna study in SQLite or PostgreSQL, and a Parquet table beside it.

Trial k's weights depend on (study seed, k, rule) and on nothing else: neither on workers, order, crashes nor resumes
(Optuna's own samplers excepted: they learn from what is finished). A trial is handed out under a lease.
"""

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
import pandas as pd
import sqlalchemy
from sqlalchemy import Connection

from formctl.evaluation import migrations
from formctl.search import overview, samplers, storage
from formctl.search.ledger import STATES, Lease, Ledger
from formctl.search.patience import Patience
from formctl.search.trials import COLUMNS, GUIDED, PARAMETERS, Weights, weights
from formctl.store import lock
from formctl.store.compare import differences
from formctl.store.files import StoreError, atomic

LEASE = 600.0
"""s without a sign of life after which a trial is handed to somebody else, unless the study says otherwise."""


@dataclass(frozen=True)
class Ticket:
    """A trial that was handed out: its weights, and the lease that lets its holder write about it."""

    trial: int
    weights: Weights
    lease: Lease


class Study:
    """A study and the run folder it belongs to."""

    def __init__(self, folder: Path, ledger: Ledger, lease: float = LEASE) -> None:
        self.folder, self.ledger, self.lease = folder, ledger, lease
        self.seed, self.rule = int(ledger.facts["seed"]), str(ledger.facts["rule"])
        self.settings: dict[str, Any] = ledger.facts["settings"]
        self._rows: dict[int, dict[str, Any]] = {}  # of finished trials, by id in the database
        self._backend: optuna.storages.RDBStorage | None = None
        self._patience = Patience()

    @classmethod
    def create(
        cls,
        folder: Path,
        *,
        seed: int,
        rule: str,
        settings: Mapping[str, Any],
        url: sqlalchemy.URL | None = None,
        name: str = "weights",
        **facts: Any,
    ) -> "Study":
        """A new, empty study, in ``folder/study.db`` or at ``url``.

        ``settings`` is everything that trials must share to be comparable, ``facts`` what else a worker needs to know.
        """
        if rule in GUIDED:
            samplers.make(rule, seed, 0)
        else:
            weights(seed, 0, rule)  # what cannot be drawn is refused before anything is written
        facts |= {"seed": seed, "rule": rule, "settings": dict(settings)}
        if url is not None:
            _make(url, name, facts)
            return cls.open(folder, url, name)
        unfinished = folder / ".study.db"  # a study that a crash left half made is never seen
        unfinished.unlink(missing_ok=True)
        _make(storage.sqlite(unfinished), name, facts)
        unfinished.replace(folder / "study.db")
        made = cls.open(folder)
        made.write_table()
        return made

    @classmethod
    def open(cls, folder: Path, url: sqlalchemy.URL | None = None, name: str | None = None) -> "Study":
        """The study in ``folder``, or ``name`` at ``url``. Raises StoreError: none, damaged, foreign, unreachable."""
        path = folder / "study.db"
        if url is None and not path.is_file():
            raise StoreError(f"{path} does not exist; `formctl search` makes a study")
        return cls(folder, Ledger(url or storage.sqlite(path), name))

    def refuse_other(self, settings: Mapping[str, Any], *, seed: int, rule: str) -> None:
        """Raise StoreError when trials made with these settings would not be comparable to those that are here.

        A key that the program got after the study began counts as the value that does what was done before.
        """
        ours = {"seed": self.seed, "rule": self.rule, **migrations.filled(self.settings, settings)}
        changed = differences(ours, {"seed": seed, "rule": rule, **settings})
        if changed:
            first = {
                key.split(".")[0]: f"{key} was {was}, is now {now}" for key, (was, now) in reversed(changed.items())
            }
            some = "; ".join(reversed(first.values()))
            raise StoreError(f"{self.folder} has other settings ({some}); type name=NAME for a new study")

    def counts(self) -> dict[str, int]:
        """Trials per state: done, failed, pruned, running."""
        return overview.counts(self.ledger)

    def missing(self, total: int) -> int:
        """Trials still to finish until the study has ``total``; a failed or pruned trial is a finished one."""
        counts = self.counts()
        return max(0, total - sum(counts[state] for state in ("done", "failed", "pruned")))

    def claim(self, total: int) -> Ticket | None:
        """What is to be done next: a trial that was given back or left behind, or a new one; None for nothing."""
        lease = self.ledger.claim(total, self.lease, self._make)
        return None if lease is None else Ticket(lease.trial, self._weights(lease), lease)

    def take_over(self) -> int:
        """Hand out everything again that is not finished: for the one owner of a SQLite study. Returns how many."""
        return self.ledger.take_over()

    def report(self, ticket: Ticket, steps: int, value: float) -> None:
        """A point of the trial's learning curve, and a sign of life. Raises LeaseLost."""
        self.ledger.renew(ticket.lease, (steps, float(value)) if math.isfinite(value) else None)

    def finish(self, ticket: Ticket, outcome: Mapping[str, Any]) -> None:
        """Complete a trial with what it keeps: ``sr`` is its value, all of ``outcome`` its attributes.

        Raises StoreError when ``sr`` is not a rate; LeaseLost.
        """
        rate = float(outcome["sr"])
        if not 0.0 <= rate <= 1.0:
            raise StoreError(f"trial {ticket.trial} came back with sr={rate}, which is not a rate")
        self.ledger.settle(ticket.lease, "COMPLETE", rate, outcome)
        self.write_table(patient=True)

    def fail(self, ticket: Ticket, reason: str, **attributes: Any) -> None:
        """Record a trial that cannot be finished, with its reason. Raises LeaseLost."""
        self.ledger.settle(ticket.lease, "FAIL", None, {"error": reason, **attributes})
        self.write_table(patient=True)

    def prune(self, ticket: Ticket, reason: str, **attributes: Any) -> None:
        """Record a trial that was given up early. Raises LeaseLost."""
        self.ledger.settle(ticket.lease, "PRUNED", None, {"error": reason, **attributes})
        self.write_table(patient=True)

    def give_back(self, ticket: Ticket, lost: bool = False) -> None:
        """Let somebody else go on with the trial; ``lost`` when its worker died. Raises LeaseLost."""
        self.ledger.give_back(ticket.lease, lost)

    def table(self) -> pd.DataFrame:
        """One row per trial, columns COLUMNS."""
        trials = self.ledger.ask("SELECT trial_id, number, state FROM trials WHERE study_id = :study ORDER BY number")
        fresh = overview.columns(self.ledger, [row.trial_id for row in trials if row.trial_id not in self._rows])
        rows = []
        for row in trials:
            known = self._rows.get(row.trial_id) or fresh[row.trial_id]
            rows.append(dict.fromkeys(COLUMNS) | known | {"trial": row.number, "state": STATES[row.state]})
            if STATES[row.state] in ("done", "pruned"):
                self._rows[row.trial_id] = known
        return pd.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)

    def write_table(self, patient: bool = False) -> None:
        """Rewrite ``trials.parquet``, atomically; of several processes the last one has read last.

        ``patient`` leaves it for the next time where writing, which grows with the study, would take much of the time.
        """
        if patient and not self._patience.due():
            return
        with (
            self._patience.spend(),
            lock.hold(self.folder / "trials.lock", patience=30),
            atomic(self.folder / "trials.parquet") as path,
        ):
            self.table().to_parquet(path, index=False)

    def note(self, trial_id: int, **attributes: Any) -> None:
        """Put attributes on a trial, finished or not."""
        self._rows.pop(trial_id, None)
        self.ledger.note(trial_id, attributes)

    def optuna(self, sampler: "optuna.samplers.BaseSampler | None" = None) -> optuna.Study:
        """The study as Optuna sees it."""
        with storage.troubles(self.ledger.url):
            if self._backend is None:
                self._backend = open_storage(self.ledger.url)
            return optuna.load_study(study_name=self.ledger.name, storage=self._backend, sampler=sampler)

    def _make(self, connection: Connection, number: int) -> int:
        if self.rule not in GUIDED:
            vector = weights(self.seed, number, self.rule)
            return self.ledger.insert(connection, number, dict(zip(PARAMETERS, vector, strict=True)))
        with storage.troubles(self.ledger.url):
            return self.optuna(samplers.make(self.rule, self.seed, number)).ask()._trial_id

    def _weights(self, lease: Lease) -> Weights:
        if self.rule not in GUIDED:
            return weights(self.seed, lease.trial, self.rule)
        study = self.optuna(samplers.make(self.rule, self.seed, lease.trial))
        with storage.troubles(self.ledger.url):
            vector = samplers.propose(optuna.Trial(study, lease.trial_id))
        self.ledger.renew(lease, attributes=dict(zip(PARAMETERS, vector, strict=True)))
        return vector


def known(url: sqlalchemy.URL) -> list[str]:
    """Names of the studies at ``url``; none in a database that Optuna has not used yet. Raises StoreError."""
    engine = storage.connect(url)
    with storage.troubles(url), engine.connect() as connection:
        if not sqlalchemy.inspect(connection).has_table("studies"):
            return []
        return list(connection.scalars(sqlalchemy.text("SELECT study_name FROM studies")))


def open_storage(url: sqlalchemy.URL) -> optuna.storages.RDBStorage:
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    logging.getLogger("alembic").setLevel(logging.WARNING)
    address = url.render_as_string(hide_password=False).replace("{", "{{").replace("}", "}}")  # Optuna formats it
    return optuna.storages.RDBStorage(address, engine_kwargs=storage.options(url))


def _make(url: sqlalchemy.URL, name: str, facts: Mapping[str, Any]) -> None:
    """Make the study with its facts, or finish one that a crash left half made."""
    with storage.troubles(url):
        backend = open_storage(url)
        study = optuna.create_study(storage=backend, study_name=name, direction="maximize", load_if_exists=True)
        for key in ("rule", "settings", "seed"):  # a study that lacks one of these is not opened
            study.set_user_attr(key, facts[key])
        backend.remove_session()
        backend.engine.dispose()
    ledger = Ledger(url, name)
    ledger.note_study(facts)
    ledger.close()
