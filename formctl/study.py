"""The weight search's record: an Optuna study in SQLite, readable with any Optuna tool, and a Parquet table beside it.

Trial k's weights depend on (study seed, k, rule) and on nothing else: neither on workers, order, crashes nor resumes.
The database hands out the trial numbers, so a number is given once however many ask.
"""

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
import pandas as pd
from optuna.distributions import BaseDistribution
from optuna.exceptions import StorageInternalError
from optuna.trial import FrozenTrial, TrialState
from sqlalchemy.exc import SQLAlchemyError

from formctl.compare import differences
from formctl.files import StoreError, atomic
from formctl.trials import COLUMNS, PARAMETERS, Weights, weights

NAME = "weights"  # of the one Optuna study in each database
STATES = {TrialState.COMPLETE: "done", TrialState.FAIL: "failed", TrialState.RUNNING: "running"}


class WeightSampler(optuna.samplers.BaseSampler):
    """Optuna's view of ``weights``: the trial's number decides, not the sampler's state."""

    def __init__(self, seed: int, rule: str) -> None:
        self.seed, self.rule = seed, rule

    def infer_relative_search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        return {}

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        return {}

    def sample_independent(
        self, study: optuna.Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution
    ) -> float:
        return weights(self.seed, trial.number, self.rule)[PARAMETERS.index(param_name)]


@dataclass(frozen=True)
class Ticket:
    """A trial that was handed out: its number and its weights."""

    trial: int
    weights: Weights


class Study:
    """The study in ``folder/study.db``. One process writes; any number reads ``trials.parquet``."""

    def __init__(self, folder: Path, study: optuna.Study) -> None:
        self.folder = folder
        self.seed = int(study.user_attrs["seed"])
        self.rule = str(study.user_attrs["rule"])
        self.settings: dict[str, Any] = study.user_attrs["settings"]
        self._study = study
        self._study.sampler = WeightSampler(self.seed, self.rule)

    @classmethod
    def create(cls, folder: Path, *, seed: int, rule: str, settings: Mapping[str, Any]) -> "Study":
        """A new, empty study. ``settings`` is everything that trials must share to be comparable."""
        weights(seed, 0, rule)  # an unknown rule is refused before anything is written
        unfinished = folder / ".study.db"  # a study that a crash left half made is never seen
        unfinished.unlink(missing_ok=True)
        with _database(folder):
            storage = optuna.storages.RDBStorage(_address(unfinished))
            study = optuna.create_study(storage=storage, study_name=NAME, direction="maximize")
            for key, value in {"seed": seed, "rule": rule, "settings": dict(settings)}.items():
                study.set_user_attr(key, value)
            storage.remove_session()
            storage.engine.dispose()
        unfinished.replace(folder / "study.db")
        made = cls.open(folder)
        made.write_table()
        return made

    @classmethod
    def open(cls, folder: Path) -> "Study":
        """The study in ``folder``. Raises StoreError where there is none, or a damaged or foreign database."""
        path = folder / "study.db"
        if not path.is_file():
            raise StoreError(f"{path} does not exist; `formctl search` makes a study")
        with _database(folder):
            try:
                return cls(folder, optuna.load_study(storage=_address(path), study_name=NAME))
            except KeyError as error:
                raise StoreError(f"{path} is not a study of formctl (no {error})") from error

    def refuse_other(self, settings: Mapping[str, Any], *, seed: int, rule: str) -> None:
        """Raise StoreError when trials made with these settings would not be comparable to those that are here."""
        ours = {"seed": self.seed, "rule": self.rule, **self.settings}
        changed = differences(ours, {"seed": seed, "rule": rule, **settings})
        if changed:
            first = {
                key.split(".")[0]: f"{key} was {was}, is now {now}" for key, (was, now) in reversed(changed.items())
            }
            some = "; ".join(reversed(first.values()))
            raise StoreError(f"{self.folder} has other settings ({some}); type name=NAME for a new study")

    def counts(self) -> dict[str, int]:
        """Trials per state: done, failed, running."""
        states = [STATES.get(trial.state, "running") for trial in self._trials()]
        return {state: states.count(state) for state in STATES.values()}

    def missing(self, total: int) -> int:
        """Trials still to finish until the study has ``total``; a failed trial is a finished one."""
        counts = self.counts()
        return max(0, total - counts["done"] - counts["failed"])

    def tickets(self, total: int) -> Iterator[Ticket]:
        """Hand out what is missing: first the trials that were left running (their process is gone), then new ones."""
        left = [trial for trial in self._trials() if trial.state == TrialState.RUNNING and trial.number < total]
        for frozen in left:
            yield self._ticket(optuna.Trial(self._study, frozen._trial_id))
        while len(self._trials()) < total:
            with _database(self.folder):
                trial = self._study.ask()
            yield self._ticket(trial)

    def note(self, trial: int, **attributes: Any) -> None:
        """Put user attributes on a trial."""
        with _database(self.folder):
            handle = self._handle(trial)
            for key, value in attributes.items():
                handle.set_user_attr(key, value)

    def report(self, trial: int, steps: int, value: float) -> None:
        """A point of the trial's learning curve. Costs milliseconds: report sparsely."""
        if math.isfinite(value):
            with _database(self.folder):
                self._handle(trial).report(value, steps)

    def finish(self, trial: int, outcome: Mapping[str, Any]) -> None:
        """Complete a trial with what it keeps: ``sr`` is its value, all of ``outcome`` its attributes.

        Raises StoreError when ``sr`` is not a rate.
        """
        rate = float(outcome["sr"])
        if not 0.0 <= rate <= 1.0:
            raise StoreError(f"trial {trial} came back with sr={rate}, which is not a rate")
        self.note(trial, **outcome)
        with _database(self.folder):
            self._study.tell(trial, rate, skip_if_finished=True)
        self.write_table()

    def fail(self, trial: int, reason: str, **attributes: Any) -> None:
        """Record a trial that cannot be finished, with its reason."""
        self.note(trial, error=reason, **attributes)
        with _database(self.folder):
            self._study.tell(trial, state=TrialState.FAIL, skip_if_finished=True)
        self.write_table()

    def table(self) -> pd.DataFrame:
        """One row per trial, columns COLUMNS."""
        rows = []
        for trial in self._trials():
            row = dict.fromkeys(COLUMNS) | trial.user_attrs | trial.params
            rows.append(row | {"trial": trial.number, "state": STATES.get(trial.state, "running")})
        return pd.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)

    def write_table(self) -> None:
        """Rewrite ``trials.parquet``, atomically."""
        with atomic(self.folder / "trials.parquet") as path:
            self.table().to_parquet(path, index=False)

    def _trials(self) -> Sequence[FrozenTrial]:
        with _database(self.folder):
            return self._study.get_trials(deepcopy=False)

    def _handle(self, trial: int) -> optuna.Trial:
        return optuna.Trial(self._study, self._trials()[trial]._trial_id)

    def _ticket(self, trial: optuna.Trial) -> Ticket:
        with _database(self.folder):
            formation, flight, obstacle, action = (trial.suggest_float(name, 0.0, 1.0) for name in PARAMETERS)
        return Ticket(trial.number, (formation, flight, obstacle, action))


def _address(path: Path) -> str:
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    logging.getLogger("alembic").setLevel(logging.WARNING)
    return f"sqlite:///{path.resolve()}"


@contextmanager
def _database(folder: Path) -> Iterator[None]:
    """Turn what a damaged, full, locked or read-only database raises into one line."""
    try:
        yield
    except (SQLAlchemyError, StorageInternalError) as error:
        cause = error.__cause__ or error
        reason = str(getattr(cause, "orig", None) or cause).splitlines()[0]
        raise StoreError(f"{folder / 'study.db'} cannot be used: {reason}") from error
