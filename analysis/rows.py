"""Everything that was measured, read back from a store: episodes, study trials and training logs as data frames.

``load(root)`` scans run records and reads what lies beside them. A damaged or foreign file does not spoil the rest:
it is left out and named, one line each, in ``Store.problems``; the readers of single files raise those lines.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from analysis import records
from analysis.records import Run

if TYPE_CHECKING:  # heavy imports wait until there is something to read
    import pandas as pd
    import pyarrow as pa

_T = TypeVar("_T")

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

TRIAL_COLUMNS: dict[str, str] = {
    **dict.fromkeys(("trial", "seed"), "integer"),
    "state": "text",
    **dict.fromkeys(("w_formation", "w_flight", "w_obstacle", "w_action", "sr", "sr_k", "sr_n"), "number"),
}


@dataclass(frozen=True)
class Store:
    """What a store holds. ``problems`` names, one line each, what was left out and why."""

    root: Path
    runs: tuple[Run, ...]
    problems: tuple[str, ...]
    tables: Mapping[str, "pa.Table"]  # eval run id -> its episodes
    studies: Mapping[str, "pa.Table"]  # search run id -> its trials
    logs: Mapping[str, list[dict[str, object]]]  # train run id -> its metrics.jsonl

    def run(self, id: str) -> Run:
        """The run of that id. Raises KeyError when it was not read."""
        return self._by_id[id]

    @cached_property
    def _by_id(self) -> dict[str, Run]:
        return {run.id: run for run in self.runs}

    def profile_of(self, run: Run) -> str:
        """The least serious profile among a run, its rows, and the training its policy comes from."""
        profiles = {run.profile}
        if run.id in self.tables:
            profiles |= {str(value) for value in self.tables[run.id]["profile"].unique().to_pylist() if value}
        if run.method and run.method.run in self._by_id:
            profiles.add(self._by_id[run.method.run].profile)
        return records.weakest(profiles)

    def profiles(self) -> list[str]:
        """Profiles under which anything was measured, the most serious first."""
        measured = [*self.tables, *self.studies, *self.logs]
        return sorted({self.profile_of(self.run(id)) for id in measured}, key=lambda p: (-records.seriousness(p), p))

    @cached_property
    def episodes(self) -> "pd.DataFrame":
        """All episodes, oldest run first, with ``eval_run`` (the run they stand in) as one more column."""
        return _frame(self.tables, "eval_run")

    @cached_property
    def trials(self) -> "pd.DataFrame":
        """All trials of all studies, with ``study`` (the search run) as one more column."""
        return _frame(self.studies, "study")

    @cached_property
    def progress(self) -> "pd.DataFrame":
        """All training logs, with ``train_run`` as one more column; metrics that a run did not log are NaN."""
        import pandas as pd

        frames = [pd.DataFrame(lines).assign(train_run=id) for id, lines in self.logs.items() if lines]
        return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame()


def load(root: Path | str) -> Store:
    """Read a whole store. A missing or empty folder is an empty store; ValueError when ``root`` is not a folder."""
    root = Path(root)
    runs, problems = records.scan(root)
    tables: dict[str, pa.Table] = {}
    studies: dict[str, pa.Table] = {}
    logs: dict[str, list[dict[str, object]]] = {}
    for run in runs:
        if run.kind == "eval" and run.status == "done":
            _keep(tables, run.id, read_episodes, run.folder / "episodes.parquet", problems)
        elif run.kind == "eval":
            problems.append(f"{run.folder} is {run.status}: its episodes are left out")
        elif run.kind == "search" and (run.folder / "trials.parquet").exists():
            _keep(studies, run.id, read_trials, run.folder / "trials.parquet", problems)
        elif run.kind == "train" and not run.trial and (run.folder / "metrics.jsonl").exists():
            _keep(logs, run.id, read_log, run.folder / "metrics.jsonl", problems)
        try:
            _ = run.config
        except ValueError as error:
            problems.append(f"{error}; its rows are left out")
            for measured in (tables, studies, logs):
                measured.pop(run.id, None)
    return Store(root, tuple(runs), tuple(problems), tables, studies, logs)


def read_episodes(path: Path) -> "pa.Table":
    """One ``episodes.parquet``: a row per episode. ValueError when damaged, empty or of other columns."""
    table = _read_parquet(path, IDENTITY | METRICS, "episode rows")
    if "metric_version" not in table.column_names:
        raise ValueError(f"{path} holds no episode rows: column 'metric_version' is missing")
    if table.num_rows == 0:
        raise ValueError(f"{path} holds no episodes")
    import pyarrow as pa
    import pyarrow.compute as pc

    unmeasured = pc.sum(pc.and_(table["cfr"], pc.invert(pc.fill_null(pc.is_finite(table["fm"]), False)))).as_py()
    if table["cfr"].null_count or unmeasured:
        raise ValueError(f"{path} is damaged: 'cfr' is empty, or 'fm' is no number, in {unmeasured or 'some'} episodes")
    for name, (family, value) in LATER.items():
        if name not in table.column_names:
            table = table.append_column(name, pa.array([value] * table.num_rows))
        elif not _is(kind := table.schema.field(name).type, family):
            raise ValueError(f"{path} holds no episode rows: column '{name}' is {kind}, {family} was expected")
    return table


def read_trials(path: Path) -> "pa.Table":
    """One study's ``trials.parquet``: a row per trial. ValueError when damaged or of other columns."""
    return _read_parquet(path, TRIAL_COLUMNS, "study trials")


def read_log(path: Path) -> list[dict[str, object]]:
    """One training's ``metrics.jsonl``. A last line cut while it was written is passed over; ValueError otherwise."""
    lines: list[dict[str, object]] = []
    text = path.read_text(encoding="utf-8", errors="replace")
    written = text.split("\n")
    for number, line in enumerate(written, start=1):
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
            if not isinstance(entry, dict) or "steps" not in entry:
                raise ValueError("an object with 'steps' was expected")
        except ValueError as error:
            if number == len(written):  # no newline yet: the writer was stopped in the middle
                break
            raise ValueError(f"{path}, line {number} is not a log entry: {error}") from error
        lines.append(entry)
    return lines


def _keep(into: dict[str, _T], id: str, read: Callable[[Path], _T], path: Path, problems: list[str]) -> None:
    try:
        into[id] = read(path)
    except (ValueError, OSError) as error:
        problems.append(" ".join(str(error).split()))


def _read_parquet(path: Path, columns: Mapping[str, str], what: str) -> "pa.Table":
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not path.exists():
        raise ValueError(f"{path} is missing, though its run is recorded")
    try:
        table = pq.read_table(path, partitioning=None)
    except (pa.ArrowException, OSError) as error:
        raise ValueError(f"{path} is not a readable Parquet file: {' '.join(str(error).split())[:160]}") from error
    for name, family in columns.items():
        if name not in table.column_names:
            raise ValueError(f"{path} holds no {what}: column '{name}' is missing")
        kind = table.schema.field(name).type
        if not _is(kind, family):
            raise ValueError(f"{path} holds no {what}: column '{name}' is {kind}, {family} was expected")
    return table


def _is(kind: "pa.DataType", family: str) -> bool:
    import pyarrow.types as types

    if types.is_null(kind):  # a column without a single value says nothing wrong
        return family in ("text", "integer")
    if types.is_dictionary(kind):
        kind = kind.value_type
    tests: dict[str, Callable[[pa.DataType], bool]] = {
        "text": lambda k: types.is_string(k) or types.is_large_string(k),
        "integer": types.is_integer,
        "flag": types.is_boolean,
        "number": lambda k: types.is_floating(k) or types.is_integer(k),
    }
    return tests[family](kind)


def _frame(tables: Mapping[str, "pa.Table"], label: str) -> "pd.DataFrame":
    """Stack Arrow tables to one frame; texts become categories, so 200,000 rows stay small and quick to group."""
    import pandas as pd
    import pyarrow as pa

    if not tables:
        return pd.DataFrame()
    labelled = []
    for id, table in tables.items():
        codes = pa.array([0] * table.num_rows, pa.int32())
        labelled.append(table.append_column(label, pa.DictionaryArray.from_arrays(codes, pa.array([id]))))
    stacked = pa.concat_tables([_encoded(table) for table in labelled], promote_options="permissive")
    frame: pd.DataFrame = stacked.unify_dictionaries().to_pandas()
    return frame


def _encoded(table: "pa.Table") -> "pa.Table":
    import pyarrow as pa
    import pyarrow.types as types

    for position, field in enumerate(table.schema):
        if types.is_string(field.type) or types.is_large_string(field.type):
            encoded = table.column(position).cast(pa.string()).dictionary_encode()
            table = table.set_column(position, field.name, encoded)
        elif types.is_dictionary(field.type) and field.name not in ("eval_run", "study"):
            plain = table.column(position).cast(pa.string())
            table = table.set_column(position, field.name, plain.dictionary_encode())
    return table
