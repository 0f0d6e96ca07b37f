"""Run folders: ``runs/<kind>/<name>/<id>/`` with ``run.json``. Plain files are the truth, listing is scanning.

A process that works on a run holds a lock on ``run.lock`` in it. The operating system drops that lock when the process
goes away, however it goes: a run that says *running* and is not locked was interrupted.
"""

import os
import re
import secrets
import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

from formctl.errors import Withdrawn
from formctl.store import lock
from formctl.store.files import (
    StoreError,
    append_line,
    disk_errors,
    plain,
    read_json,
    read_lines,
    write_json,
    write_lines,
    write_text,
)

SCHEMA = 1
KINDS = ("search", "train", "eval", "report", "reproduce", "bench", "export")
STATUSES = ("created", "running", "done", "failed", "interrupted")


@dataclass(frozen=True)
class Run:
    """One run folder, for reading. Nothing is cached: every property reads the file behind it."""

    path: Path

    @classmethod
    def open(cls, path: Path) -> "Run":
        """The run in ``path``. Raises StoreError for a folder that is not a run."""
        if not path.is_dir():
            raise StoreError(f"{path} does not exist; `formctl runs ls` lists the runs")
        if not (path / "run.json").is_file():
            raise StoreError(f"{path} is not a run folder (no run.json); `formctl runs ls` lists the runs")
        run = cls(path)
        schema = run.record.get("schema")
        if schema != SCHEMA:
            raise StoreError(f"{path} was written with schema {schema}, this formctl reads {SCHEMA}")
        return run

    @property
    def record(self) -> dict[str, Any]:
        """``run.json`` as stored."""
        return read_json(self.path / "run.json")

    @property
    def kind(self) -> str:
        return str(self.record["kind"])

    @property
    def name(self) -> str:
        return str(self.record["name"])

    @property
    def id(self) -> str:
        return str(self.record["id"])

    @property
    def status(self) -> str:
        """The recorded status, but *interrupted* where the process that was at work is gone."""
        return str(self.view()["status"])

    def view(self) -> dict[str, Any]:
        """The record with its true status: what listings show."""
        record = self.record
        if record["status"] == "running" and not self.in_use(record):
            record["status"] = "interrupted"
        return record

    def in_use(self, record: Mapping[str, Any] | None = None) -> bool:
        """Whether a process works on the run now: the lock in its folder tells.

        A record that says *running* is taken at its word where the lock may not show: on another host's machine, in a
        folder of a network. Without a lock file nobody is at work.
        """
        path = self.path / "run.lock"
        if lock.is_held(path):
            return True
        record = record or self.record
        process = record.get("process", {})
        here = process.get("machine", "") == lock.machine() or process.get("host") == socket.gethostname()
        return record["status"] == "running" and path.exists() and not here and not lock.shows(path)

    @property
    def config(self) -> dict[str, Any]:
        """``config.yaml`` as plain data."""
        from omegaconf import OmegaConf
        from yaml import YAMLError

        try:
            return cast(dict[str, Any], OmegaConf.to_container(OmegaConf.load(self.path / "config.yaml")))
        except (OSError, YAMLError) as error:
            raise StoreError(f"{self.path / 'config.yaml'} cannot be read: {error}") from error

    def metrics(self) -> list[dict[str, Any]]:
        """The rows of ``metrics.jsonl``; a torn last line is left out."""
        return read_lines(self.path / "metrics.jsonl")

    def checkpoint(self, name: str = "latest") -> Path:
        return self.path / "checkpoints" / f"{name}.pt"

    def update(self, **fields: Any) -> None:
        """Replace fields of the record, atomically."""
        write_json(self.path / "run.json", self.record | fields)

    @contextmanager
    def work(self) -> Iterator["LiveRun"]:
        """Own the run while the block lasts and record how it ended.

        Leaving normally sets *done*, KeyboardInterrupt and Withdrawn *interrupted*, anything else *failed* with
        its reason.
        Raises StoreError when another process owns the run.
        """
        with self._owned():
            record = self.record
            live = LiveRun(self.path, float(record.get("minutes") or 0.0), time.monotonic())
            process = {"pid": os.getpid(), "host": socket.gethostname(), "machine": lock.machine()}
            started = record.get("started") or now()
            live.update(status="running", process=process, started=started, finished=None, error=None)
            try:
                yield live
            except KeyboardInterrupt:
                live.close("interrupted")
                raise
            except Withdrawn as error:
                live.close("interrupted", str(error))
                raise
            except BaseException as error:
                with suppress(StoreError):  # a full disk has already been reported: by the error that is raised here
                    live.close("failed", f"{type(error).__name__}: {error}".splitlines()[0][:300])
                raise
            live.close("done")

    @contextmanager
    def _owned(self) -> Iterator[None]:
        try:
            with lock.hold(self.path / "run.lock"):
                yield
        except lock.Held as error:
            process = self.record.get("process", {})
            where = f"process {process.get('pid')} on {process.get('host')}"
            raise StoreError(f"{self.path} is in use by {where}") from error


@dataclass(frozen=True)
class LiveRun(Run):
    """A run that this process owns: what may be written while it runs."""

    minutes_before: float
    since: float

    @property
    def minutes(self) -> float:
        """Minutes of work, earlier sittings included."""
        return self.minutes_before + (time.monotonic() - self.since) / 60

    def log(self, row: Mapping[str, Any]) -> None:
        """Append a row to ``metrics.jsonl``."""
        append_line(self.path / "metrics.jsonl", row)

    def rewind(self, steps: int) -> None:
        """Drop metric rows past ``steps``, and a torn last line: a resumed training writes them again."""
        rows = self.metrics()
        write_lines(self.path / "metrics.jsonl", [row for row in rows if row.get("steps", 0) <= steps])

    def keep_time(self) -> None:
        """Put the minutes so far on record, so that a killed run does not forget them."""
        self.update(minutes=round(self.minutes, 4))

    def close(self, status: str, error: str | None = None) -> None:
        self.update(status=status, finished=now(), minutes=round(self.minutes, 4), error=error)


def create(
    root: Path,
    kind: str,
    name: str,
    *,
    config: Mapping[str, Any],
    provenance: Mapping[str, Any],
    argv: Sequence[str],
    profile: str,
    seed: int,
    parents: Sequence[str] = (),
    folder: Path | None = None,
    identifier: str | None = None,
    **fields: Any,
) -> Run:
    """Make a run folder with its record and ``config.yaml``; ``fields`` (method, scenario, bank, budget) go on record.

    ``folder`` places the run elsewhere than ``root/kind/name/id``: the trials of a search live inside the search's own.
    ``identifier`` is given where the run is known to other hosts by an id already.
    Raises StoreError for a name that is not one folder name and for a disk that cannot be written.
    """
    from omegaconf import OmegaConf

    check_name(name)
    identifier = identifier or new_id()
    path = folder or root / kind / name / identifier
    record = {"schema": SCHEMA, "kind": kind, "name": name, "id": identifier, "status": "created", "profile": profile}
    record |= {"seed": seed, "argv": list(argv), "created": now(), "started": None, "finished": None, "minutes": 0.0}
    record |= {"parents": list(parents), "provenance": dict(provenance), "budget": {}, "result": {}, "error": None}
    with disk_errors(path):
        path.mkdir(parents=True, exist_ok=folder is not None)
    write_text(path / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(plain(config))))
    write_json(path / "run.json", record | fields)
    return Run(path)


def scan(
    root: Path,
    *,
    kind: str | None = None,
    name: str | None = None,
    status: str | None = None,
    profile: str | None = None,
) -> list[Run]:
    """Runs under ``root`` that match, newest first. Folders without a readable record are passed over."""
    wanted = {"status": status, "profile": profile}
    found = []
    for path in root.glob(f"{kind or '*'}/{name or '*'}/*/run.json"):
        run = Run(path.parent)
        try:
            record = run.view()
        except StoreError:
            continue
        if all(value in (None, record.get(key)) for key, value in wanted.items()):
            found.append((record.get("created") or "", record["id"], run))
    return [run for *_, run in sorted(found, key=lambda item: item[:2], reverse=True)]


def latest(root: Path, kind: str, name: str) -> Run | None:
    """The newest run of that kind and name, if there is one."""
    runs = scan(root, kind=kind, name=name)
    return runs[0] if runs else None


def resolve(text: str, root: Path, *, kind: str | None = None, holding: str | None = None) -> Run:
    """The run that a user means by ``text``: a path, an id, the beginning of one, NAME, KIND/NAME or KIND/NAME/ID.

    A name means its newest run, among those with a file ``holding`` where one is asked for.
    Raises StoreError: not a run, ambiguous, or none found and what there is instead.
    """
    path = Path(text).expanduser()
    if path.is_dir() and ((path / "run.json").exists() or "/" in text or text in (".", "..")):
        return Run.open(path)
    runs = [run for run in scan(root, kind=kind) if holding is None or (run.path / holding).exists()]
    keys = {run.path: (run.path.name, run.path.parent.name, run.path.parent.parent.name) for run in runs}
    for run in runs:  # newest first
        identifier, name, its_kind = keys[run.path]
        if text in (name, f"{its_kind}/{name}", identifier, f"{its_kind}/{name}/{identifier}"):
            return run
    begun = [run for run in runs if keys[run.path][0].startswith(text)]
    if len(begun) == 1:
        return begun[0]
    what = f"{kind} run" if kind else "run"
    if begun:
        ids = ", ".join(run.path.name for run in begun[:4])
        raise StoreError(f"'{text}' is ambiguous: {len(begun)} {what}s begin so ({ids}, ...); type more of the id")
    with_file = f" with {'an' if holding[0] in 'aeiou' else 'a'} {holding}" if holding else ""
    names = sorted({f"{keys[run.path][2]}/{keys[run.path][1]}" for run in runs})
    there = f"there are {', '.join(names[:8])}" if names else "there is none yet"
    raise StoreError(f"no {what}{with_file} '{text}' in {root}/: {there}")


def check_name(name: str) -> None:
    """Raise StoreError where ``name`` cannot be a folder name."""
    if not re.fullmatch(r"[^\W_][\w.=,+-]*", name):
        raise StoreError(f"name='{name}' cannot name a folder; letters, digits and ._=,+- can, a letter or digit first")


def new_id() -> str:
    """UTC timestamp and four hexadecimal digits."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(2)}"


def now() -> str:
    """UTC time to the millisecond, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
