"""A weight search's record: an Optuna study, the leases of those who work for it, and a table of its trials.

Trial k's weights depend on (study seed, k, law) and on nothing else: neither on workers, order, crashes nor resumes
(Optuna's own samplers excepted: they learn from what is finished). A finished trial is recorded once: a lease is needed
for it, no two processes record at a time, and where it will stand is noted before it is written.
"""

import math
from collections.abc import Callable, Mapping
from datetime import datetime, timedelta
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

import optuna
import sqlalchemy
from optuna.trial import FrozenTrial, TrialState, create_trial

from envs.vocabulary import Weights
from formctl.evaluation import migrations
from formctl.search import database, samplers, table
from formctl.search.laws import GUIDED, PARAMETERS, weights
from formctl.search.leases import OPEN, Leases, Ticket
from formctl.search.samplers import INDEX, SPACE, WeightSampler
from formctl.search.table import Row
from formctl.search.throttle import Throttle
from formctl.store.compare import differences
from formctl.store.files import StoreError, plain

LEASE = 600.0
"""s without a sign of life after which a trial is handed to somebody else, unless the study says otherwise."""

STATES = {"done": TrialState.COMPLETE, "failed": TrialState.FAIL, "pruned": TrialState.PRUNED}
"""Final states of a trial, ours and Optuna's."""

FACTS = ("seed", "rule", "settings")
"""User attributes without which a study is not one of ours."""

T = TypeVar("T")


class WeightStudy:
    """The study ``name`` in the database at ``url``, and the run folder it belongs to."""

    def __init__(self, folder: Path, url: sqlalchemy.URL, name: str = table.NAME, lease: float = LEASE) -> None:
        self.folder, self.url, self.name, self.lease = folder, url, name, lease
        self.leases = Leases(url, name)
        self._throttle = Throttle()
        self.facts = self.read_facts()
        if absent := [key for key in FACTS if key not in self.facts]:
            raise StoreError(f"{database.shown(url)} is not a study of formctl (no {absent[0]})")
        self.seed, self.rule = int(self.facts["seed"]), str(self.facts["rule"])
        self.settings: dict[str, Any] = self.facts["settings"]

    @classmethod
    def create(
        cls,
        folder: Path,
        *,
        seed: int,
        rule: str,
        settings: Mapping[str, Any],
        url: sqlalchemy.URL | None = None,
        name: str = table.NAME,
        **facts: Any,
    ) -> "WeightStudy":
        """A new, empty study, in ``folder/study.db`` or at ``url``; one that a crash left half made is finished.

        ``settings`` is everything that trials must share to be comparable, ``facts`` what else a worker needs to know.
        Raises StoreError, before anything is written, for a rule that proposes nothing.
        """
        if "vectors" not in facts:
            samplers.guided(rule, seed, 0) if rule in GUIDED else weights(seed, 0, rule)
        if url is None:
            url = database.sqlite(folder / "study.db")
        backend = database.open_storage(url, make=True)
        make = optuna.create_study
        made = database.attempt(
            url, lambda: make(storage=backend, study_name=name, direction="maximize", load_if_exists=True)
        )
        Leases(url, name).prepare()
        for key, value in (facts | {"rule": rule, "settings": dict(settings), "seed": seed}).items():
            database.attempt(url, partial(made.set_user_attr, key, value))
        return cls(folder, url, name)

    @cached_property
    def _storage(self) -> optuna.storages.RDBStorage:
        return database.open_storage(self.url)

    def in_optuna(self, sampler: optuna.samplers.BaseSampler | None = None) -> optuna.Study:
        """The study as Optuna sees it: its finished trials, and those that its own samplers were asked for."""
        sampler = sampler or WeightSampler(self.seed, self.rule)
        return self._do(lambda: optuna.load_study(study_name=self.name, storage=self._storage, sampler=sampler))

    def read_facts(self) -> dict[str, Any]:
        """What is known of the study as a whole. Raises StoreError where there is no such study."""
        try:
            return self._do(lambda: self._storage.get_study_user_attrs(self._study_id))
        except KeyError as error:
            there = ", ".join(sorted(known(self.url))[:8]) or "none"
            raise StoreError(f"{database.shown(self.url)} has no study {self.name}: there is {there}") from error

    @staticmethod
    def recorded_facts(url: sqlalchemy.URL, name: str) -> dict[str, Any]:
        """The facts of a study that may be half made, or not made at all."""
        if name not in known(url):
            return {}
        return database.attempt(
            url, lambda: optuna.load_study(study_name=name, storage=database.open_storage(url)).user_attrs
        )

    def close(self) -> None:
        """Let go of all connections; the next question makes new ones."""
        self.leases.close()
        if backend := self.__dict__.pop("_storage", None):
            backend.remove_session()
            backend.engine.dispose()

    def note(self, **facts: Any) -> None:
        """Note facts about the study."""
        study = self.in_optuna()
        for key, value in facts.items():
            self._do(partial(study.set_user_attr, key, value))
        self.facts |= facts

    def total(self) -> int:
        """Trials that the study is to have, as its owner last said."""
        return int(self.read_facts()["trials"])

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
        if not self.leases.exist():
            raise StoreError(f"{self.folder} was begun by an earlier formctl; type name=NAME for a new study")

    def counts(self) -> dict[str, int]:
        """Trials per state: done, failed, pruned, running."""
        return self.leases.counts()

    def missing(self, total: int) -> int:
        """Trials still to finish until the study has ``total``; a failed or pruned trial is a finished one."""
        counts = self.counts()
        return max(0, total - sum(counts[state] for state in STATES))

    def claim(self, total: int) -> Ticket | None:
        """What is to be done next: a trial that was given back or left behind, or a new one; None for nothing."""
        with self.leases.alone():
            for row in self.leases.free(total, self.lease):
                if (recorded := self._recorded(row)) is not None:  # its worker died between recording and saying so
                    self.leases.set(row.trial, state=recorded, token=None)
                    continue
                if row.weights is None:
                    self.leases.set(row.trial, weights=self._ask(row.trial, row.number))
                return self.leases.lend(self.leases.row(row.trial))
            trial = sum(self.counts().values())
            if trial >= total:
                return None
            if self.rule in GUIDED:  # noted first, so that what a crash leaves asked is gone on with
                number = self._count()
                self.leases.add(trial, number=number)
                self.leases.set(trial, weights=self._ask(trial, number))
            else:
                self.leases.add(trial, weights=self._law(trial))
            return self.leases.lend(self.leases.row(trial))

    def report(self, ticket: Ticket, steps: int, value: float | None) -> None:
        """A sign of life, with a point of the trial's learning curve where there is one. Raises LeaseLost."""
        if value is not None and math.isfinite(value):
            ticket.curve[steps] = float(value)
        self.leases.renew(ticket)

    def prune_reason(self, ticket: Ticket, pruner: optuna.pruners.BasePruner) -> str | None:
        """Why ``pruner`` gives the trial up as far as it is; None where it does not."""
        seen = create_trial(
            state=TrialState.RUNNING, user_attrs={INDEX: ticket.trial}, intermediate_values=dict(ticket.curve)
        )
        seen.number = ticket.trial
        study = self.in_optuna()
        gone = bool(ticket.curve) and self._do(lambda: pruner.prune(study, seen))
        return f"{type(pruner).__name__}, after {max(ticket.curve):,} steps" if gone else None

    def finish(self, ticket: Ticket, outcome: Mapping[str, Any]) -> None:
        """Complete a trial with what it keeps: ``sr`` is its value, all of ``outcome`` its attributes.

        Raises StoreError when ``sr`` is not a rate; LeaseLost.
        """
        rate = float(outcome["sr"])
        if not 0.0 <= rate <= 1.0:
            raise StoreError(f"trial {ticket.trial} came back with sr={rate}, which is not a rate")
        self._settle(ticket, "done", rate, outcome)

    def fail(self, ticket: Ticket, reason: str, **attributes: Any) -> None:
        """Record a trial that cannot be finished, with its reason. Raises LeaseLost."""
        self._settle(ticket, "failed", None, {"error": reason, **attributes})

    def prune(self, ticket: Ticket, reason: str, **attributes: Any) -> None:
        """Record a trial that was given up early. Raises LeaseLost."""
        self._settle(ticket, "pruned", None, {"error": reason, **attributes})

    def give_back(self, ticket: Ticket, lost: bool = False) -> None:
        """Let somebody else go on with the trial; ``lost`` when its worker died. Raises LeaseLost."""
        self.leases.end(ticket, OPEN, lost)

    def note_trial(self, trial: int, **notes: Any) -> None:
        """Put what was found out about a finished trial on its record."""
        self.leases.set(trial, notes=(self.leases.row(trial).notes or {}) | notes)

    def write_table(self, throttled: bool = False) -> None:
        """Rewrite ``trials.parquet``; ``throttled`` leaves it for later where that would take much of the time."""
        if not throttled or self._throttle.due():
            with self._throttle.turn():
                table.write(self.folder, self.rows())

    def rows(self) -> list[Row]:
        """One row per trial that was begun, by index: what the database says."""
        return table.rows(self.folder, self.leases, self.read)

    def read(self, number: int) -> Row:
        """What Optuna keeps of the trial of that number."""
        return table.row(self._trial(number))

    def _settle(self, ticket: Ticket, state: str, value: float | None, attributes: Mapping[str, Any]) -> None:
        kept = plain(attributes)
        with self.leases.alone():
            row = self.leases.hold(ticket)
            vector = dict(zip(PARAMETERS, row.weights, strict=True))
            asked = self._unfinished(row.number)
            self.leases.set(row.trial, number=row.number if asked else self._count())
            if asked:
                self._tell(row.number, state, value, ticket.curve, {INDEX: row.trial, **vector, **kept})
            else:
                self._add(state, value, vector, ticket.curve, {INDEX: row.trial, **kept})
            self.leases.end(ticket, state)
        self.write_table(throttled=True)

    def _add(
        self,
        state: str,
        value: float | None,
        vector: dict[str, float],
        curve: dict[int, float],
        attributes: dict[str, Any],
    ) -> None:
        """Record a finished trial, in one transaction."""
        finished = create_trial(
            state=STATES[state],
            value=value,
            params=vector,
            distributions=SPACE,
            user_attrs=attributes,
            intermediate_values=dict(curve),
        )
        finished.datetime_start = datetime.now() - timedelta(minutes=attributes.get("minutes") or 0.0)
        study = self.in_optuna()
        self._do(lambda: study.add_trial(finished))

    def _tell(
        self, number: int, state: str, value: float | None, curve: dict[int, float], attributes: dict[str, Any]
    ) -> None:
        """Finish the trial that one of Optuna's samplers was asked for."""
        identifier = self._identifier(number)
        for steps, at in curve.items():
            self._do(partial(self._storage.set_trial_intermediate_value, identifier, steps, at))
        for key, item in attributes.items():
            self._do(partial(self._storage.set_trial_user_attr, identifier, key, item))
        study = self.in_optuna(samplers.guided(self.rule, self.seed, int(attributes[INDEX])))
        self._do(lambda: study.tell(number, value, STATES[state]))

    def _unfinished(self, number: int | None) -> bool:
        """Whether Optuna has a trial of that number that waits for its end."""
        return number is not None and number < self._count() and not self._trial(number).state.is_finished()

    def _recorded(self, row: Any) -> str | None:
        """The state in which a trial that looks open is on record already."""
        if row.number is None or row.number >= self._count():
            return None
        trial = self._trial(row.number)
        if not trial.state.is_finished() or trial.user_attrs.get(INDEX) != row.trial:
            return None
        return next(state for state, theirs in STATES.items() if theirs == trial.state)

    def _law(self, trial: int) -> Weights:
        """Weights that nothing but the study's seed and the index decides, or those of a given list."""
        if "vectors" in self.facts:
            formation, flight, obstacle, action = self.facts["vectors"][trial]
            return formation, flight, obstacle, action
        return weights(self.seed, trial, self.rule)

    def _ask(self, trial: int, number: int) -> Weights:
        """What one of Optuna's samplers proposes; what was asked before a crash is gone on with."""
        study = self.in_optuna(samplers.guided(self.rule, self.seed, trial))
        there = number < self._count()
        asked = optuna.Trial(study, self._identifier(number)) if there else self._do(study.ask)
        return self._do(lambda: samplers.propose(asked))

    @property
    def _study_id(self) -> int:
        return self._storage.get_study_id_from_name(self.name)

    def _count(self) -> int:
        """Trials that Optuna has."""
        return self._do(lambda: self._storage.get_n_trials(self._study_id))

    def _trial(self, number: int) -> FrozenTrial:
        """Optuna's trial of that number. Raises KeyError."""
        return self._do(lambda: self._storage.get_trial(self._identifier(number)))

    def _identifier(self, number: int) -> int:
        """The storage's own name for the trial of that number. Raises KeyError."""
        find = self._storage.get_trial_id_from_study_id_trial_number
        return self._do(lambda: find(self._study_id, number))

    def _do(self, act: Callable[[], T]) -> T:
        return database.attempt(self.url, act)


def known(url: sqlalchemy.URL) -> list[str]:
    """Names of the studies at ``url``; none in a database that Optuna has not used yet. Raises StoreError."""
    if not database.attempt(url, lambda: sqlalchemy.inspect(database.connect(url)).has_table("studies")):
        return []
    return database.attempt(url, lambda: optuna.get_all_study_names(database.open_storage(url)))
