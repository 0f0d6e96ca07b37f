"""Who works on which trial of a study: one table beside Optuna's, for what Optuna has no word for.

A row is a trial that was begun. While it is open, a lease says who works on it and when they last gave a sign of life,
in the database's own time; every event names its lease, and one that was taken over in the meantime is refused.
"""

import os
import secrets
import socket
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import sqlalchemy
from sqlalchemy import JSON, Column, Connection, Float, Integer, MetaData, Row, String, Table, func, select

from envs.vocabulary import Weights
from formctl.search import database

OPEN = "running"
"""State of a trial that is not finished, whether or not somebody works on it; the others are done, failed, pruned."""

TRIALS = Table(
    "formctl_trials",
    MetaData(),
    Column("study", String(255), primary_key=True),  # its name in Optuna
    Column("trial", Integer, primary_key=True),  # its index: what its weights follow from
    Column("state", String(16), nullable=False),
    Column("number", Integer),  # Optuna's, where it is recorded or about to be
    Column("weights", JSON),
    Column("curve", JSON),  # learning curve so far: {steps: value}
    Column("notes", JSON),  # what was found out after it was finished
    Column("token", String(64)),  # of the lease; none: nobody works on it
    Column("host", String(255)),
    Column("process", Integer),
    Column("seen", Float, nullable=False),  # s since 1970, by the database
    Column("losses", Integer, nullable=False),  # workers that died on it
)

T = TypeVar("T")


class LeaseLost(Exception):
    """The trial was handed to somebody else in the meantime."""


@dataclass(frozen=True)
class Ticket:
    """A trial that was handed out: its weights, and the lease that lets its holder write about it."""

    trial: int
    weights: Weights
    token: str
    losses: int  # workers that this trial has lost so far
    curve: dict[int, float]  # learning curve so far, by steps


class Leases:
    """The trials of one study. Reading makes nothing; ``prepare`` makes the table."""

    def __init__(self, url: sqlalchemy.URL, study: str) -> None:
        self.url, self.study = url, study
        self._engine = database.connect(url)
        seconds = func.extract("epoch", func.clock_timestamp())
        self._now = seconds if url.drivername != "sqlite" else (func.julianday("now") - 2440587.5) * 86400.0

    def prepare(self) -> None:
        """Make the table where it is not there."""
        database.attempt(self.url, lambda: TRIALS.create(self._engine, checkfirst=True))

    def exist(self) -> bool:
        """Whether the table is there: studies of earlier versions have none."""
        return database.attempt(self.url, lambda: sqlalchemy.inspect(self._engine).has_table(TRIALS.name))

    def close(self) -> None:
        """Let go of all connections."""
        self._engine.dispose()

    @contextmanager
    def alone(self) -> Iterator[None]:
        """A block that no other process runs for this study. The owner of a SQLite study is alone anyway."""
        if self.url.drivername == "sqlite":
            yield
            return
        key = zlib.crc32(f"formctl {self.study}".encode())
        connection = database.attempt(self.url, self._engine.connect)
        try:
            database.attempt(self.url, lambda: connection.execute(select(func.pg_advisory_lock(key))))
            yield
        finally:
            connection.invalidate()  # the lock goes with it, whatever happened in the block
            connection.close()

    def rows(self, *which: Any) -> Sequence[Row[Any]]:
        """The trials that fit all conditions, by index; ``silent`` is s since the last sign of life."""
        table = select(TRIALS, (self._now - TRIALS.c.seen).label("silent"))
        query = table.where(TRIALS.c.study == self.study, *which).order_by(TRIALS.c.trial)
        return self._do(lambda connection: connection.execute(query).all())

    def row(self, trial: int) -> Row[Any]:
        """One trial."""
        return self.rows(TRIALS.c.trial == trial)[0]

    def counts(self) -> dict[str, int]:
        """Trials per state: done, failed, pruned, running."""
        query = select(TRIALS.c.state, func.count()).where(TRIALS.c.study == self.study).group_by(TRIALS.c.state)
        found = self._do(lambda connection: connection.execute(query).all())
        return dict.fromkeys(("done", "failed", "pruned", OPEN), 0) | {state: count for state, count in found}

    def losses(self) -> int:
        """Workers that were lost in the middle of a trial, over the whole study."""
        query = select(func.coalesce(func.sum(TRIALS.c.losses), 0)).where(TRIALS.c.study == self.study)
        return int(self._do(lambda connection: connection.execute(query).scalar_one()))

    def free(self, total: int, patience: float) -> Sequence[Row[Any]]:
        """Open trials below ``total`` that nobody works on, or whose worker was silent for more than ``patience`` s."""
        silent = TRIALS.c.seen < self._now - patience
        return self.rows(TRIALS.c.state == OPEN, TRIALS.c.trial < total, TRIALS.c.token.is_(None) | silent)

    def add(self, trial: int, **values: Any) -> None:
        """Begin a trial, with nobody at work on it yet."""
        row = {"study": self.study, "trial": trial, "state": OPEN, "seen": self._now, "losses": 0}
        self._do(lambda connection: connection.execute(TRIALS.insert().values(**row, **values)))

    def set(self, trial: int, **values: Any) -> None:
        """Change what is known of a trial, whoever works on it."""
        self._change(values, TRIALS.c.trial == trial)

    def lend(self, row: Row[Any]) -> Ticket:
        """Hand a free trial out."""
        token, losses = secrets.token_hex(8), row.losses + (row.token is not None)
        holder = {"token": token, "host": socket.gethostname(), "process": os.getpid()}
        self.set(row.trial, **holder, losses=losses, seen=self._now)
        formation, flight, obstacle, action = row.weights
        curve = {int(steps): value for steps, value in (row.curve or {}).items()}
        return Ticket(row.trial, (formation, flight, obstacle, action), token, losses, curve)

    def renew(self, ticket: Ticket) -> None:
        """A sign of life, with the learning curve so far. Raises LeaseLost."""
        self._change_held(ticket, {"seen": self._now, "curve": ticket.curve})

    def hold(self, ticket: Ticket) -> Row[Any]:
        """The row of a trial that the ticket is good for. Raises LeaseLost."""
        self._change_held(ticket, {"seen": self._now})
        return self.row(ticket.trial)

    def end(self, ticket: Ticket, state: str, lost: bool = False) -> None:
        """End a lease: the trial is in its final ``state``, or open again. Raises LeaseLost."""
        losses = TRIALS.c.losses + int(lost)
        self._change_held(ticket, {"state": state, "token": None, "seen": self._now, "losses": losses})

    def end_all(self) -> int:
        """End every lease: for an owner who knows that nobody else is there. Returns how many there were."""
        values = {"token": None, "losses": TRIALS.c.losses + 1}
        return self._change(values, TRIALS.c.state == OPEN, TRIALS.c.token.is_not(None))

    def reopen(self, total: int) -> int:
        """Open failed trials below ``total`` once more, to be recorded anew. Returns how many."""
        values = {"state": OPEN, "number": None, "curve": None}
        return self._change(values, TRIALS.c.state == "failed", TRIALS.c.trial < total)

    def _change_held(self, ticket: Ticket, values: Mapping[str, Any]) -> None:
        if self._change(values, TRIALS.c.trial == ticket.trial, TRIALS.c.token == ticket.token) != 1:
            raise LeaseLost(f"trial {ticket.trial} was handed to another worker in the meantime")

    def _change(self, values: Mapping[str, Any], *which: Any) -> int:
        statement = TRIALS.update().where(TRIALS.c.study == self.study, *which).values(**values)
        return self._do(lambda connection: connection.execute(statement).rowcount)

    def _do(self, act: Callable[[Connection], T]) -> T:
        """One transaction."""

        def transaction() -> T:
            with self._engine.begin() as connection:
                return act(connection)

        return database.attempt(self.url, transaction)
