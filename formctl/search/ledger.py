"""A study's database, one transaction per event: trials in Optuna's schema, beside them the leases of those who work.

Optuna's own calls commit every attribute of a trial by itself: a hundred milliseconds for a finished one on SQLite, and
half an event on record after a crash. So events are written here, in the SQL that SQLite and PostgreSQL share, and any
Optuna tool reads them. A lease says who works on a trial and when they last gave a sign of life, in the database's own
time; every event names its lease, and one that was taken over in the meantime is told no.
"""

import json
import os
import secrets
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any

import sqlalchemy
from sqlalchemy import Connection, DateTime, Row, bindparam, text

from formctl.search import storage
from formctl.store.files import StoreError, plain

STATES = {"COMPLETE": "done", "FAIL": "failed", "PRUNED": "pruned", "RUNNING": "running", "WAITING": "running"}
"""Optuna's states of a trial and ours."""

_NOW = {"sqlite": "(julianday('now') - 2440587.5) * 86400.0", "postgresql": "extract(epoch from clock_timestamp())"}
_LEASES = """CREATE TABLE IF NOT EXISTS formctl_leases (trial_id INTEGER PRIMARY KEY, study_id INTEGER NOT NULL,
    token VARCHAR(64), host VARCHAR(255), process INTEGER, seen DOUBLE PRECISION NOT NULL, losses INTEGER NOT NULL)"""
_INDEX = "CREATE INDEX IF NOT EXISTS formctl_trial_states ON trials (study_id, state, number)"  # a claim takes no scan
_UNIT = json.dumps({"name": "FloatDistribution", "attributes": {"step": None, "low": 0.0, "high": 1.0, "log": False}})


class LeaseLost(Exception):
    """The trial was handed to somebody else in the meantime."""


@dataclass(frozen=True)
class Lease:
    """The right to write about one trial."""

    trial_id: int  # the database's own
    trial: int
    token: str
    losses: int  # workers that this trial has lost so far


Make = Callable[[Connection, int], int]
"""Makes trial number N and returns its id."""


class Ledger:
    """The trials of one study in the database at ``url``. Raises StoreError where that is not a study of formctl."""

    def __init__(self, url: sqlalchemy.URL, name: str | None = None) -> None:
        self.url = url
        self._engine = storage.connect(url)
        self._now = _NOW[self._engine.dialect.name]
        self.study_id, self.name, self.facts = self._open(name)

    def _open(self, name: str | None) -> tuple[int, str, dict[str, Any]]:
        """Find the study: by name, or the only one. Reads only, so that a foreign database is left as it is."""
        with storage.troubles(self.url), self._engine.connect() as connection:
            tables = set(sqlalchemy.inspect(connection).get_table_names())
            if not {"studies", "study_user_attributes"} <= tables:
                raise StoreError(f"{storage.shown(self.url)} is not a study of formctl (no trials in it)")
            studies = connection.execute(text("SELECT study_id, study_name FROM studies")).all()
            found = [study for study in studies if name in (None, study.study_name)]
            if len(found) != 1:
                there = ", ".join(sorted(study.study_name for study in studies)[:8]) or "none"
                raise StoreError(f"{storage.shown(self.url)} has no study {name or 'of its own'}: there is {there}")
            query = "SELECT key, value_json FROM study_user_attributes WHERE study_id = :study"
            rows = connection.execute(text(query), {"study": found[0].study_id})
            facts = {row.key: json.loads(row.value_json) for row in rows}
        absent = [key for key in ("seed", "rule", "settings") if key not in facts]
        if absent:
            raise StoreError(f"{storage.shown(self.url)} is not a study of formctl (no {absent[0]})")
        if "formctl_leases" not in tables:  # a study that was made before there were leases
            with self.event() as connection:
                connection.execute(text(_LEASES))
                connection.execute(text(_INDEX))
        return found[0].study_id, found[0].study_name, facts

    @contextmanager
    def event(self) -> Iterator[Connection]:
        """One transaction."""
        with storage.troubles(self.url), self._engine.begin() as connection:
            yield connection

    @contextmanager
    def _alone(self) -> Iterator[Connection]:
        """A transaction that no other claim on this study runs beside. A SQLite study has one owner anyway."""
        with self.event() as connection:
            if self._engine.dialect.name == "postgresql":
                connection.execute(text("SELECT pg_advisory_xact_lock(74177, :study)"), {"study": self.study_id})
            yield connection

    def close(self) -> None:
        """Let go of all connections."""
        self._engine.dispose()

    def note_study(self, facts: Mapping[str, Any]) -> None:
        """Note facts about the study."""
        with self.event() as connection:
            put(connection, "study", self.study_id, facts)
        self.facts |= facts

    def total(self) -> int:
        """Trials that the study is to have, as its owner last said."""
        query = "SELECT value_json FROM study_user_attributes WHERE study_id = :study AND key = 'trials'"
        return int(json.loads(self.ask(query)[0].value_json))

    def claim(self, total: int, limit: float, make: Make) -> Lease | None:
        """A trial below ``total`` that nobody works on: one given back, one whose lease is older than ``limit`` s, or
        one that ``make`` makes. None when there is none."""
        stale = f"(l.token IS NULL OR l.seen < {self._now} - :limit)"
        query = f"""SELECT t.trial_id, t.number, l.token, l.losses FROM trials t
            LEFT JOIN formctl_leases l ON l.trial_id = t.trial_id
            WHERE t.study_id = :study AND t.state = 'RUNNING' AND t.number < :total AND {stale}
            ORDER BY t.number LIMIT 1"""
        with self._alone() as connection:
            asked = {"study": self.study_id, "total": total, "limit": limit}
            left = connection.execute(text(query), asked).one_or_none()
            if left is not None:
                losses = (left.losses or 0) + (left.token is not None)
                return self._lend(connection, left.trial_id, left.number, losses, (left.token, limit))
            count = connection.scalar(text("SELECT count(*) FROM trials WHERE study_id = :study"), asked)
            if count >= total:
                return None
            return self._lend(connection, make(connection, count), count, 0, (None, limit))

    def _lend(
        self, connection: Connection, trial_id: int, trial: int, losses: int, before: tuple[str | None, float]
    ) -> Lease | None:
        """Put a new lease in the place of the one ``before``, unless that one has shown life again just now."""
        old, limit = before
        token = secrets.token_hex(8)
        query = f"""INSERT INTO formctl_leases (trial_id, study_id, token, host, process, seen, losses)
            VALUES (:trial_id, :study, :token, :host, :process, {self._now}, :losses)
            ON CONFLICT (trial_id) DO UPDATE SET token = excluded.token, host = excluded.host,
                process = excluded.process, seen = excluded.seen, losses = excluded.losses
            WHERE formctl_leases.token IS NULL
                OR (formctl_leases.token = :old AND formctl_leases.seen < {self._now} - :limit)"""
        mine = {"trial_id": trial_id, "study": self.study_id, "token": token, "losses": losses}
        mine |= {"host": socket.gethostname(), "process": os.getpid(), "old": old or "", "limit": limit}
        taken = connection.execute(text(query), mine).rowcount == 1
        return Lease(trial_id, trial, token, losses) if taken else None

    def insert(self, connection: Connection, number: int, parameters: Mapping[str, float]) -> int:
        """Make trial ``number`` with its parameters, each between 0 and 1; returns its id."""
        query = """INSERT INTO trials (number, study_id, state, datetime_start)
            VALUES (:number, :study, 'RUNNING', :now) RETURNING trial_id"""
        values = {"number": number, "study": self.study_id, "now": _utc()}
        trial_id = int(
            connection.execute(text(query).bindparams(bindparam("now", type_=DateTime())), values).scalar_one()
        )
        query = """INSERT INTO trial_params (trial_id, param_name, param_value, distribution_json)
            VALUES (:trial_id, :name, :value, :law)"""
        rows = [{"trial_id": trial_id, "name": name, "value": at, "law": _UNIT} for name, at in parameters.items()]
        connection.execute(text(query), rows)
        return trial_id

    def renew(
        self, lease: Lease, point: tuple[int, float] | None = None, attributes: Mapping[str, Any] = MappingProxyType({})
    ) -> None:
        """A sign of life, with a point (step, value) of the learning curve and attributes where there are new ones.

        Raises LeaseLost.
        """
        with self.event() as connection:
            self._hold(connection, lease, "token")
            if point is not None:
                query = """INSERT INTO trial_intermediate_values
                        (trial_id, step, intermediate_value, intermediate_value_type)
                    VALUES (:trial_id, :step, :value, 'FINITE') ON CONFLICT (trial_id, step) DO UPDATE
                    SET intermediate_value = excluded.intermediate_value, intermediate_value_type = 'FINITE'"""
                at = {"trial_id": lease.trial_id, "step": point[0], "value": point[1]}
                connection.execute(text(query), at)
            put(connection, "trial", lease.trial_id, attributes)

    def settle(self, lease: Lease, state: str, value: float | None, attributes: Mapping[str, Any]) -> None:
        """End a trial in ``state`` with all that is kept of it. Raises LeaseLost."""
        assert state in STATES
        with self.event() as connection:
            self._hold(connection, lease, "NULL")
            put(connection, "trial", lease.trial_id, attributes)
            self.complete(connection, lease.trial_id, state, value)

    def complete(self, connection: Connection, trial_id: int, state: str, value: float | None) -> None:
        """Set the final state, and the value where there is one."""
        if value is not None:
            query = """INSERT INTO trial_values (trial_id, objective, value, value_type)
                VALUES (:trial_id, 0, :value, 'FINITE')
                ON CONFLICT (trial_id, objective) DO UPDATE SET value = excluded.value"""
            connection.execute(text(query), {"trial_id": trial_id, "value": value})
        query = f"UPDATE trials SET state = '{state}', datetime_complete = :now WHERE trial_id = :trial_id"
        ended = text(query).bindparams(bindparam("now", type_=DateTime()))
        connection.execute(ended, {"trial_id": trial_id, "now": _utc()})

    def note(self, trial_id: int, attributes: Mapping[str, Any]) -> None:
        """Put attributes on a trial, whoever works on it: what is found out about it later."""
        with self.event() as connection:
            put(connection, "trial", trial_id, attributes)

    def give_back(self, lease: Lease, lost: bool) -> None:
        """Let the next claim have the trial; ``lost`` counts a worker that died on it. Raises LeaseLost."""
        with self.event() as connection:
            self._hold(connection, lease, "NULL", int(lost))

    def take_over(self) -> int:
        """End all leases: for an owner who knows that nobody else is there. Returns how many there were."""
        query = """UPDATE formctl_leases SET token = NULL, losses = losses + 1
            WHERE study_id = :study AND token IS NOT NULL"""
        with self.event() as connection:
            return connection.execute(text(query), {"study": self.study_id}).rowcount

    def retry_failed(self, total: int) -> int:
        """Make failed trials below ``total`` claimable again. Returns how many."""
        failed = "SELECT trial_id FROM trials WHERE study_id = :study AND state = 'FAIL' AND number < :total"
        with self.event() as connection:
            asked = {"study": self.study_id, "total": total}
            query = f"DELETE FROM trial_user_attributes WHERE key = 'error' AND trial_id IN ({failed})"
            connection.execute(text(query), asked)
            query = f"UPDATE trials SET state = 'RUNNING', datetime_complete = NULL WHERE trial_id IN ({failed})"
            return connection.execute(text(query), asked).rowcount

    def _hold(self, connection: Connection, lease: Lease, token: str, lost: int = 0) -> None:
        query = f"""UPDATE formctl_leases SET seen = {self._now}, token = {token}, losses = losses + :lost
            WHERE trial_id = :trial_id AND token = :token"""
        values = {"trial_id": lease.trial_id, "token": lease.token, "lost": lost}
        if connection.execute(text(query), values).rowcount != 1:
            raise LeaseLost(f"trial {lease.trial} was handed to another worker in the meantime")

    def ask(self, query: str, **values: Any) -> Sequence[Row[Any]]:
        """Rows of a question about the study; ``:study`` and ``{now}`` are filled in."""
        with self.event() as connection:
            return connection.execute(text(query.format(now=self._now)), {"study": self.study_id} | values).all()


def put(connection: Connection, of: str, key_id: int, attributes: Mapping[str, Any]) -> None:
    """Set user attributes of a ``trial`` or a ``study``."""
    if not attributes:
        return
    query = f"""INSERT INTO {of}_user_attributes ({of}_id, key, value_json) VALUES (:id, :key, :value)
        ON CONFLICT ({of}_id, key) DO UPDATE SET value_json = excluded.value_json"""
    values = plain(attributes).items()
    connection.execute(text(query), [{"id": key_id, "key": key, "value": json.dumps(item)} for key, item in values])


def _utc() -> datetime:
    return datetime.now(UTC).replace(tzinfo=None)  # as Optuna stores it
