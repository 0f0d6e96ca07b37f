"""Where the numbers come from: the runs, settings, banks and machines behind a report."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis import methods, settings
from analysis.evidence import Evidence
from analysis.records import Run

PACKAGES = ("formctl", "python", "torch", "mujoco", "numpy", "scipy", "pandas")
"""Versions that are listed, of those on record."""


@dataclass(frozen=True)
class Sources:
    """What the provenance section lists. ``left_out``: one line each for whatever was not used, and why."""

    root: Path  # of the store
    runs: tuple[Run, ...]
    kinds: tuple[settings.Kind, ...]  # their settings
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


def trace(evidence: Evidence) -> Sources:
    """Everything that a report of this evidence rests on: its evaluations, their ancestors, trainings and studies."""
    store, profile = evidence.store, evidence.profile
    known = {run.id: run for run in store.runs}
    used = {run.id for run in evidence.runs}
    used |= {run.id for run in store.runs if run.profile == profile and run.id in {*store.logs, *store.studies}}
    pending = list(used)
    while pending:
        for parent in known[pending.pop()].raw.get("parents") or ():
            if parent in known and parent not in used:
                used.add(parent)
                pending.append(parent)
    kept = [run for run in store.runs if run.id in used]
    runs = tuple(sorted(kept, key=lambda run: (run.kind != "search", run.kind != "train", run.id)))
    return Sources(
        root=store.root,
        runs=runs,
        kinds=settings.told(runs),
        banks=tuple(sorted({_bank(bank) for run in runs for bank in _banks(run)})),
        machines=_distinct(_machine(run) for run in runs),
        versions=_distinct(_versions(run) for run in runs),
        left_out=(*store.problems, *evidence.notes),
    )


def _row(run: Run) -> dict[str, str]:
    facts = run.method
    seed = facts.seed if facts and facts.kind == "policy" else run.raw.get("seed")
    minutes = run.raw.get("minutes")
    return {
        "kind": run.kind,
        "name": run.name,
        "id": run.id,
        "profile": run.profile,
        "status": run.status,
        "method": _who(run),
        "seed": "" if seed is None else str(seed),
        "steps": methods.short(facts.steps) if facts and facts.learnt else "",
        "minutes": f"{minutes:.1f}" if isinstance(minutes, int | float) else "",
        "commit": run.commit,
    }


def _who(run: Run) -> str:
    facts = run.method
    if facts is None:
        return ""
    return (
        facts.name if facts.kind != "policy" else " ".join(filter(None, (facts.algo, facts.encoder, facts.curriculum)))
    )


def _banks(run: Run) -> list[Mapping[str, Any]]:
    """The banks an evaluation flew: one under ``bank``, or one per scene under ``banks``."""
    found = [run.raw.get("bank"), *(run.raw.get("banks") or ())]
    return [bank for bank in found if isinstance(bank, dict)]


def _bank(bank: Mapping[str, Any]) -> tuple[str, str, str]:
    return str(bank.get("sha256", ""))[:16], str(bank.get("seed", "")), str(bank.get("episodes", ""))


def _machine(run: Run) -> str:
    host = (run.raw.get("provenance") or {}).get("host") or {}
    if not host:
        return ""
    parts = [host.get("processor"), f"{host['cores']} cores" if host.get("cores") else "", host.get("system")]
    if host.get("memory_gib"):
        parts.insert(2, f"{host['memory_gib']} GiB")
    return ", ".join(str(part) for part in parts if part)


def _versions(run: Run) -> str:
    found = (run.raw.get("provenance") or {}).get("versions") or {}
    return ", ".join(f"{name} {found[name]}" for name in PACKAGES if name in found)


def _distinct(texts: Iterable[str]) -> tuple[str, ...]:
    return tuple(sorted({text for text in texts if text}))
