"""Where the numbers come from: the runs, banks and machines behind a report, and every setting said once.

What a kind's runs share is said once; below it what a method, and then a run, has instead.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.data.evidence import Evidence
from analysis.data.methods import leaves
from analysis.data.runs import Run
from analysis.data.text import short

PACKAGES = ("formctl", "python", "torch", "mujoco", "numpy", "scipy", "pandas")
"""Versions that are listed, of those on record."""


@dataclass(frozen=True)
class SettingsGroup:
    """Settings that most of some runs share, a line each (``group.key: JSON value``), and the groups below."""

    name: str
    lines: tuple[str, ...]
    runs: tuple[Run, ...]
    parts: tuple["SettingsGroup", ...] = ()


@dataclass(frozen=True)
class Provenance:
    """What the provenance section lists. ``left_out``: one line each for whatever was not used, and why."""

    root: Path  # of the store
    runs: tuple[Run, ...]
    settings: tuple[SettingsGroup, ...]
    banks: tuple[tuple[str, str, str], ...]  # sha256, seed, episodes
    machines: tuple[str, ...]
    versions: tuple[str, ...]
    left_out: tuple[str, ...]

    def rows(self) -> list[dict[str, str]]:
        """One entry per run, as text."""
        return [_row(run) for run in self.runs]

    def place(self, run: Run) -> str:
        """The file with all settings of a run, from the store's folder; its record where there is no such file."""
        folder = run.folder.relative_to(self.root)
        return (folder / ("config.yaml" if (run.folder / "config.yaml").exists() else "run.json")).as_posix()

    def call(self, run: Run) -> str:
        """The command line that made a run, as it is on record."""
        return " ".join(str(word) for word in run.raw.get("argv") or ())


def trace(evidence: Evidence) -> Provenance:
    """Everything that a report of this evidence rests on: its evaluations, their ancestors, trainings and studies."""
    store, profile = evidence.store, evidence.profile
    used = {run.id for run in evidence.runs}
    used |= {run.id for run in store.runs if run.profile == profile and run.id in {*store.logs, *store.studies}}
    pending = list(used)
    while pending:
        for parent in store.by_id[pending.pop()].raw.get("parents") or ():
            if parent in store.by_id and parent not in used:
                used.add(parent)
                pending.append(parent)
    chosen = [run for run in store.runs if run.id in used]
    runs = tuple(sorted(chosen, key=lambda run: (run.kind != "search", run.kind != "train", run.id)))
    banks = {(str(b.get("sha256", ""))[:16], str(b.get("seed", "")), str(b.get("episodes", ""))) for b in _banks(runs)}
    return Provenance(
        root=store.root,
        runs=runs,
        settings=shared_settings(runs),
        banks=tuple(sorted(banks)),
        machines=_distinct(map(_machine, runs)),
        versions=_distinct(map(_versions, runs)),
        left_out=(*store.problems, *evidence.notes),
    )


def shared_settings(runs: Sequence[Run]) -> tuple[SettingsGroup, ...]:
    """The settings of all runs by kind and method, in the order of the runs."""
    trees = {run.id: leaves(_config(run)) for run in runs}
    kinds = []
    for name, alike in _grouped(runs, lambda run: run.kind).items():
        shared = usual([trees[run.id] for run in alike])
        methods = []
        for method, members in _grouped(alike, method_of).items():
            common = usual([trees[run.id] for run in members])
            own = tuple(SettingsGroup(run.id, instead(trees[run.id], common), (run,)) for run in members)
            title = f"{name} {method}".strip()
            methods.append(SettingsGroup(title, instead(common, shared), tuple(members), own))
        lines = tuple(f"{key}: {value}" for key, value in shared.items())
        kinds.append(SettingsGroup(name, lines, tuple(alike), tuple(methods)))
    return tuple(kinds)


def method_of(run: Run) -> str:
    """The method that a run trains or flies, by learner or baseline; a deployment is a group of its own."""
    facts = run.method
    who = "" if facts is None else facts.algo if facts.kind == "policy" else facts.name
    return ", ".join(filter(None, (who, "deployment" if _config(run).get("deploy") else "")))


def usual(trees: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Every key's value in more than half of the trees. Empty trees, of runs without settings, do not count."""
    known = [tree for tree in trees if tree]
    found = {}
    for key in dict.fromkeys(key for tree in reversed(known) for key in tree):  # the latest run has most keys in place
        value, count = Counter(tree.get(key) for tree in known).most_common(1)[0]
        if value is not None and 2 * count > len(known):
            found[key] = value
    return found


def instead(tree: Mapping[str, str], common: Mapping[str, str]) -> tuple[str, ...]:
    """What ``tree`` has instead of ``common``, a line each, and in one more line the keys that it does not have."""
    if not tree:
        return ()
    lines = [f"{key}: {value}" for key, value in tree.items() if common.get(key) != value]
    groups = {key[:at] for key in tree for at, letter in enumerate(key) if letter == "."}
    lost = [key for key in common if key not in tree and key not in groups and not _within(key, tree)]
    return tuple([*lines, *([f"# without {', '.join(lost)}"] if lost else [])])


def _within(key: str, tree: Mapping[str, str]) -> bool:
    """Whether a group that ``key`` belongs to is a value in ``tree``, as in ``baseline: null``."""
    return any(key[:at] in tree for at, letter in enumerate(key) if letter == ".")


def _grouped(runs: Iterable[Run], name: Callable[[Run], str]) -> dict[str, list[Run]]:
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(name(run), []).append(run)
    return groups


def _config(run: Run) -> Mapping[str, object]:
    """A run's settings; none where its file is damaged, which the report says among what it left out."""
    try:
        return run.config
    except ValueError:
        return {}


def _row(run: Run) -> dict[str, str]:
    facts, minutes = run.method, run.raw.get("minutes")
    policy = facts is not None and facts.kind == "policy"
    words = () if facts is None else (facts.algo, facts.encoder, facts.curriculum) if policy else (facts.name,)
    seed = facts.seed if facts is not None and policy else run.raw.get("seed")
    return {name: getattr(run, name) for name in ("kind", "name", "id", "profile", "status", "commit")} | {
        "method": " ".join(filter(None, words)),
        "seed": "" if seed is None else str(seed),
        "steps": short(facts.steps) if facts and facts.learnt else "",
        "minutes": f"{minutes:.1f}" if isinstance(minutes, int | float) else "",
    }


def _banks(runs: Iterable[Run]) -> list[Mapping[str, Any]]:
    return [bank for run in runs for bank in run.banks]


def _machine(run: Run) -> str:
    host = (run.raw.get("provenance") or {}).get("host") or {}
    cores = f"{host['cores']} cores" if host.get("cores") else ""
    memory = f"{host['memory_gib']} GiB" if host.get("memory_gib") else ""
    return ", ".join(filter(None, (str(host.get("processor") or ""), cores, memory, str(host.get("system") or ""))))


def _versions(run: Run) -> str:
    known = (run.raw.get("provenance") or {}).get("versions") or {}
    return ", ".join(f"{name} {known[name]}" for name in PACKAGES if name in known)


def _distinct(texts: Iterable[str]) -> tuple[str, ...]:
    return tuple(sorted({text for text in texts if text}))
