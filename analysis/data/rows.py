"""Everything that was measured, read back from a store: episodes, study trials and training logs as data frames.

``load(root)`` scans run records and reads what lies beside them. A damaged or foreign file does not spoil the rest:
it is left out and named, one line each, in ``Store.problems``; the readers of single files raise those lines.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pandas.api import types

from analysis.data import runs
from analysis.data.runs import Run

IDENTITY: dict[str, str] = {
    **dict.fromkeys(("method", "run", "profile", "scenario", "ball_aim", "sim", "drone", "bank"), "text"),
    **dict.fromkeys(("seed", "columns", "balls", "drones", "scenario_id"), "integer"),
}
"""Columns that say which episode a row is, and the family of their values; ``metric_version`` may be either."""

FLAGS = ("cfr", "cfr_strict", "sr", "ok_formation", "ok_flight", "ok_obstacle", "ok_action")
METRICS: dict[str, str] = {**dict.fromkeys(FLAGS, "flag"), "fm": "number"}
"""Metric columns that tables and figures use; every other column of a file is kept as it is."""

LATER: dict[str, tuple[str, float | str]] = {
    "planner_failures": ("integer", 0),
    "planner_reason": ("text", ""),
    **dict.fromkeys(("message_period", "message_delay", "message_loss"), ("number", 0.0)),
}
"""Columns that rows of earlier versions do not have: the family of their values, and what stands there then."""

WEIGHTS = ("w_formation", "w_flight", "w_obstacle", "w_action")
"""Columns of a study's trials that hold the weights."""

TRIAL_COLUMNS: dict[str, str] = {
    **dict.fromkeys(("trial", "seed"), "integer"),
    "state": "text",
    **dict.fromkeys((*WEIGHTS, "sr", "sr_k", "sr_n"), "number"),
}

FAMILIES: Mapping[str, Callable[[pd.Series], bool]] = {
    "text": lambda values: types.is_string_dtype(values) or bool(values.isna().all()),
    "integer": lambda values: types.is_integer_dtype(values) or bool(values.isna().all()),
    "flag": types.is_bool_dtype,
    "number": lambda values: types.is_numeric_dtype(values) and not types.is_bool_dtype(values),
}


@dataclass(frozen=True)
class Store:
    """What a store holds. ``problems`` names, one line each, what was left out and why."""

    root: Path
    runs: tuple[Run, ...]
    problems: tuple[str, ...]
    tables: Mapping[str, pd.DataFrame]  # eval run id -> its episodes
    studies: Mapping[str, pd.DataFrame]  # search run id -> its trials
    logs: Mapping[str, pd.DataFrame]  # train run id -> its metrics.jsonl

    def run(self, id: str) -> Run:
        """The run of that id. Raises KeyError when it was not read."""
        return self.by_id[id]

    @cached_property
    def by_id(self) -> dict[str, Run]:
        """Every run that was read, by its id."""
        return {run.id: run for run in self.runs}

    def profile_of(self, run: Run) -> str:
        """The least serious profile among a run, its rows, and the training its policy comes from."""
        profiles = {run.profile}
        if run.id in self.tables:
            profiles |= {str(value) for value in self.tables[run.id]["profile"].unique() if value}
        if run.method and run.method.run in self.by_id:
            profiles.add(self.by_id[run.method.run].profile)
        return runs.weakest(profiles)

    def profiles(self) -> list[str]:
        """Profiles under which anything was measured, the most serious first."""
        measured = [*self.tables, *self.studies, *self.logs]
        return sorted({self.profile_of(self.run(id)) for id in measured}, key=lambda p: (-runs.seriousness(p), p))

    @cached_property
    def episodes(self) -> pd.DataFrame:
        """All episodes, oldest run first, with ``eval_run`` (the run they stand in) as one more column."""
        return _stacked(self.tables, "eval_run")

    @cached_property
    def winners(self) -> list[tuple[float, ...]]:
        """Weights that searches have chosen: those flown on fresh episodes."""
        tables = [table for table in self.studies.values() if "sr_fresh_n" in table]
        chosen = [table.loc[table["sr_fresh_n"].notna(), list(WEIGHTS)] for table in tables]
        return [tuple(map(float, weights)) for frame in chosen for weights in frame.to_numpy()]

    @cached_property
    def trials(self) -> pd.DataFrame:
        """All trials of all studies, with ``study`` (the search run) as one more column."""
        return _stacked(self.studies, "study")


def load(root: Path | str) -> Store:
    """Read a whole store. A missing or empty folder is an empty store; ValueError when ``root`` is not a folder."""
    records, problems = runs.scan(Path(root))
    tables: dict[str, pd.DataFrame] = {}
    studies: dict[str, pd.DataFrame] = {}
    logs: dict[str, pd.DataFrame] = {}
    for run in records:
        try:
            _ = run.config
            if run.kind == "eval" and run.status == "done":
                tables[run.id] = read_episodes(run.folder / "episodes.parquet")
            elif run.kind == "eval":
                problems.append(f"{run.folder} is {run.status}: its episodes are left out")
            elif run.kind == "search" and (run.folder / "trials.parquet").exists():
                studies[run.id] = read_trials(run.folder / "trials.parquet")
            elif run.kind == "train" and not run.trial and (run.folder / "metrics.jsonl").exists():
                logs[run.id] = read_log(run.folder / "metrics.jsonl")
        except (ValueError, OSError) as error:
            problems.append(f"{' '.join(str(error).split())}; what it holds is left out")
    return Store(Path(root), tuple(records), tuple(problems), tables, studies, logs)


def read_episodes(path: Path) -> pd.DataFrame:
    """One ``episodes.parquet``: a row per episode. ValueError when damaged, empty or of other columns."""
    frame = _read_parquet(path, IDENTITY | METRICS, "episode rows")
    if "metric_version" not in frame:
        raise ValueError(f"{path} holds no episode rows: column 'metric_version' is missing")
    if frame.empty:
        raise ValueError(f"{path} holds no episodes")
    unmeasured = int((frame["cfr"] & ~np.isfinite(frame["fm"].to_numpy(float))).sum())
    if unmeasured:
        raise ValueError(f"{path} is damaged: 'fm' is no number in {unmeasured} successful episodes")
    for name, (family, value) in LATER.items():
        if name not in frame:
            frame[name] = value
        _check(path, frame[name], family, "episode rows")
    return frame


def read_trials(path: Path) -> pd.DataFrame:
    """One study's ``trials.parquet``: a row per trial. ValueError when damaged or of other columns."""
    return _read_parquet(path, TRIAL_COLUMNS, "study trials")


def read_log(path: Path) -> pd.DataFrame:
    """One training's ``metrics.jsonl``. A last line cut while it was written is passed over; ValueError otherwise."""
    entries: list[dict[str, Any]] = []
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
            if not isinstance(entry, dict) or "steps" not in entry:
                raise ValueError("an object with 'steps' was expected")
        except ValueError as error:
            if number == len(lines):  # no newline yet: the writer was stopped in the middle
                break
            raise ValueError(f"{path}, line {number} is not a log entry: {error}") from error
        entries.append(entry)
    return pd.DataFrame(entries)


def _read_parquet(path: Path, columns: Mapping[str, str], what: str) -> pd.DataFrame:
    if not path.exists():
        raise ValueError(f"{path} is missing, though its run is recorded")
    try:
        frame = pd.read_parquet(path, partitioning=None)
    except (ValueError, OSError) as error:  # pyarrow's errors are ValueErrors
        raise ValueError(f"{path} is not a readable Parquet file: {' '.join(str(error).split())[:160]}") from error
    for name, family in columns.items():
        if name not in frame:
            raise ValueError(f"{path} holds no {what}: column '{name}' is missing")
        _check(path, frame[name], family, what)
    return frame


def _check(path: Path, values: pd.Series, family: str, what: str) -> None:
    kind = values.cat.categories.to_series() if isinstance(values.dtype, pd.CategoricalDtype) else values
    if not FAMILIES[family](kind):
        raise ValueError(f"{path} holds no {what}: column '{values.name}' is {kind.dtype}, {family} was expected")


def _stacked(tables: Mapping[str, pd.DataFrame], label: str) -> pd.DataFrame:
    """Frames on top of each other; texts become categories, so 200,000 rows stay small and quick to group."""
    if not tables:
        return pd.DataFrame()
    stacked = pd.concat([_typed(frame).assign(**{label: id}) for id, frame in tables.items()], ignore_index=True)
    texts = [name for name in stacked if isinstance(stacked[name].dtype, pd.CategoricalDtype | pd.StringDtype)]
    texts += [name for name in stacked if stacked[name].dtype == object and name not in texts]
    return stacked.astype(dict.fromkeys(texts, "category"))


def _typed(frame: pd.DataFrame) -> pd.DataFrame:
    """Columns without a single value as numbers: what other files have there decides what they are."""
    return frame.astype({name: float for name in frame if frame[name].dtype == object and frame[name].isna().all()})
