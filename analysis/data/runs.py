"""Run folders as records: ``runs/<kind>/<name>/<id>/run.json``, and the settings beside it in ``config.yaml``."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

SCHEMA = 1
"""Version of ``run.json`` that this package reads."""

KINDS = ("search", "train", "eval", "report", "reproduce", "bench", "export")
STATUSES = ("created", "running", "done", "failed", "interrupted")

REQUIRED: dict[str, type] = {"schema": int} | dict.fromkeys(("kind", "name", "id", "status", "profile"), str)


@dataclass(frozen=True)
class MethodFacts:
    """Who flew, as ``run.json`` says it under ``method``; empty text and None where the record has nothing."""

    name: str
    kind: str  # policy | baseline
    algo: str
    encoder: str
    curriculum: str
    weights: tuple[float, ...]  # formation, flight, obstacle, action; () for baselines
    steps: int | None  # environment steps trained
    seed: int
    run: str  # id of the training run, "" for baselines
    published_steps: int | None = None  # of the training that a learned baseline stands for
    experiment: str = ""  # named set of settings that it was trained with
    deviations: tuple[str, ...] = ()  # of a baseline, from what was published

    @classmethod
    def read(cls, facts: Mapping[str, Any]) -> "MethodFacts":
        """From the record. Raises TypeError or ValueError for values of another type."""
        steps = facts.get("steps")
        return cls(
            name=str(facts.get("name") or "unnamed"),
            kind=str(facts.get("kind") or "policy"),
            algo=str(facts.get("algo") or ""),
            encoder=str(facts.get("encoder") or ""),
            curriculum=str(facts.get("curriculum") or ""),
            weights=tuple(float(weight) for weight in facts.get("weights") or ()),
            steps=None if steps is None else int(steps),
            seed=int(facts.get("seed") or 0),
            run=str(facts.get("run") or ""),
            published_steps=facts.get("published_steps"),
            experiment=str(facts.get("experiment") or ""),
            deviations=tuple(map(str, facts.get("deviations") or ())),
        )

    @property
    def learnt(self) -> bool:
        """Whether it was trained: a policy, or a learnt baseline."""
        return self.kind == "policy" or bool(self.steps)


@dataclass(frozen=True)
class Run:
    """One run folder. ``raw`` keeps the whole record; the fields are those that the analysis uses."""

    folder: Path
    kind: str
    name: str
    id: str
    status: str
    profile: str
    raw: Mapping[str, Any]

    @cached_property
    def method(self) -> MethodFacts | None:
        """Who was trained or flown; None where the record names no method."""
        facts = self.raw.get("method")
        return MethodFacts.read(facts) if isinstance(facts, dict) else None

    @property
    def trial(self) -> bool:
        """True for the training of a search's trial, which lies inside the search's own folder."""
        return self.folder.parent.name == "trials"

    @property
    def banks(self) -> list[Mapping[str, Any]]:
        """The banks an evaluation flew: one under ``bank``, or one per scene under ``banks``."""
        return [bank for bank in self.raw.get("banks") or [self.raw.get("bank")] if isinstance(bank, dict)]

    @property
    def commit(self) -> str:
        """Short git commit, with an asterisk for uncommitted changes; "unknown" where none is on record."""
        git = (self.raw.get("provenance") or {}).get("git") or {}
        return str(git.get("commit") or "unknown")[:7] + ("*" if git.get("dirty") else "")

    @cached_property
    def config(self) -> dict[str, Any]:
        """``config.yaml`` as a plain tree; empty where there is no such file. ValueError when it is damaged."""
        path = self.folder / "config.yaml"
        if not path.exists():
            return {}
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        try:
            tree = yaml.load(path.read_text(encoding="utf-8"), Loader=loader)
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ValueError(f"{path} is not readable YAML: {_one_line(error)}") from error
        if not isinstance(tree, dict):
            raise ValueError(f"{path} holds no settings: a mapping of groups was expected")
        return tree


def read_run(folder: Path) -> Run:
    """Read one run folder's ``run.json``.

    Raises ValueError, one line with the path, when the file is damaged, of another schema or not a run record.
    """
    path = folder / "run.json"
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not readable JSON: {_one_line(error)}") from error
    if not isinstance(raw, dict):
        raise ValueError(f"{path} is not a run record: an object was expected, found {type(raw).__name__}")
    for key, kind in REQUIRED.items():
        if not isinstance(raw.get(key), kind):
            raise ValueError(f"{path} is not a run record: '{key}' is missing or of another type")
    if raw["schema"] != SCHEMA:
        raise ValueError(f"{path} has schema {raw['schema']}; this version reads schema {SCHEMA}")
    for key, choices in (("kind", KINDS), ("status", STATUSES)):
        if raw[key] not in choices:
            raise ValueError(f"{path}: {key} '{raw[key]}' is not one of {', '.join(choices)}")
    run = Run(folder, raw["kind"], raw["name"], raw["id"], raw["status"], raw["profile"], raw)
    try:
        _ = run.method
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: 'method' is not readable: {_one_line(error)}") from error
    return run


def scan(root: Path, kinds: Iterable[str] = ("search", "train", "eval")) -> tuple[list[Run], list[str]]:
    """All runs below ``root`` in the order of their ids (oldest first), and one line for every unreadable record.

    The trainings of a search's trials are among them (``Run.trial``).

    Raises ValueError when ``root`` exists but is no folder; a missing folder is an empty store.
    """
    if root.exists() and not root.is_dir():
        raise ValueError(f"{root} is not a folder; give the output store, usually runs/")
    runs: list[Run] = []
    problems: list[str] = []
    paths = [path for kind in kinds for path in root.glob(f"{kind}/*/*/run.json")]
    for path in sorted([*paths, *root.glob("search/*/*/trials/*/run.json")]):
        try:
            runs.append(read_run(path.parent))
        except (ValueError, OSError) as error:
            problems.append(_one_line(error))
    runs.sort(key=lambda run: (run.id, run.kind))
    return runs, problems


def seriousness(profile: str) -> int:
    """Rank of a profile: smoke 0, any user's own profile 1, laptop 2, paper 3."""
    return {"smoke": 0, "laptop": 2, "paper": 3}.get(profile, 1)


def weakest(profiles: Iterable[str]) -> str:
    """The least serious of several profiles: a policy trained under ``smoke`` stays ``smoke`` wherever it is flown."""
    return min(sorted(profiles), key=seriousness)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())
