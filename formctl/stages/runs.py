"""Run folders listed, shown, compared, named, checked and removed: what ``formctl runs`` does."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from formctl import store
from formctl.console import print_yaml, say, table, warn
from formctl.errors import ConfigError
from formctl.store import Run, manifest, removal
from formctl.store.compare import differences


def list_runs(
    root: Path,
    *,
    kind: str | None = None,
    name: str | None = None,
    status: str | None = None,
    profile: str | None = None,
    tag: str | None = None,
) -> list[Run]:
    """Print the runs of a store that match, newest first, and return them. Raises ConfigError for a wrong filter."""
    check_filter(kind, store.KINDS, "--kind")
    check_filter(status, store.STATUSES, "--status")
    runs = store.scan(root, kind=kind, name=name, status=status, profile=profile)
    if tag is not None:
        runs = [run for run in runs if tag in run.record.get("tags", [])]
    if not runs:
        filtered = any(value is not None for value in (kind, name, status, profile, tag))
        say(f"no runs in {root}/ that match" if filtered else nothing(root))
        return []
    columns = ("id", "kind", "name", "status", "profile", "minutes", "tags", "result")
    table(columns, [line(run) for run in runs])
    return runs


def show(text: str, root: Path) -> None:
    """Print a run's record and what lies in its folder."""
    run = store.resolve(text, root)
    print_yaml(run.view())
    files = sorted(path for path in run.path.rglob("*") if path.is_file() and path.name != "run.lock")
    table(("file", "bytes"), [(path.relative_to(run.path), path.stat().st_size) for path in files])


def diff(text: str, other: str, root: Path) -> None:
    """Print the settings, results and versions in which two runs differ."""
    left, right = (store.resolve(word, root) for word in (text, other))
    lines = []
    for what, ours, theirs in (
        ("setting", left.config, right.config),
        ("result", left.record["result"], right.record["result"]),
        ("version", left.record["provenance"].get("versions", {}), right.record["provenance"].get("versions", {})),
        ("git", left.record["provenance"].get("git", {}), right.record["provenance"].get("git", {})),
    ):
        lines += [(what, key, *pair) for key, pair in differences(ours, theirs).items()]
    if not lines:
        say(f"{left.id} and {right.id} have the same settings, results and versions")
        return
    table(("what", "key", left.id, right.id), lines)


def tag(text: str, tags: Sequence[str], root: Path, *, remove: bool = False) -> None:
    """Put tags on a run, or take them away."""
    for word in tags:
        store.check_name(word)
    run = store.resolve(text, root)
    before: list[str] = run.record.get("tags", [])
    after = [word for word in before if word not in tags] if remove else list(dict.fromkeys([*before, *tags]))
    run.update(tags=after)
    say(f"{run.path}: {', '.join(after) or 'no tags'}")


def remove(texts: Sequence[str], root: Path, *, really: bool = False) -> None:
    """Remove runs, or say what would go. Raises StoreError for what a study or a report still needs."""
    runs = [store.resolve(text, root) for text in texts]
    for run in runs:
        removal.refuse_needed(run, root)
    for run in runs:
        if really:
            say(f"removed {run.path}: {removal.remove(run, root) / 1e6:.1f} MB")
        else:
            say(f"would remove {run.path}; add --yes")


def seal(folder: Path) -> None:
    """Write the manifest of a store that is to be published. Raises StoreError for one without runs."""
    if not store.scan(folder):
        raise store.StoreError(f"{folder} is no store: it has no run")
    manifest.write(folder)
    for path in manifest.personal(folder):
        warn(f"{path} names a path of this machine")
    say(f"{folder / manifest.NAME}: {manifest.text(folder)}")


def nothing(place: Path) -> str:
    """What to say of a store without runs, or of a folder that is not there."""
    return f"no runs in {place}/ yet; formctl train makes one" if place.is_dir() else f"there is no store {place}/"


def check_filter(value: str | None, choices: tuple[str, ...], option: str) -> None:
    """Raise ConfigError for a filter that can never match."""
    if value is not None and value not in choices:
        raise ConfigError(f"{option} {value} is none of {', '.join(choices)}")


def line(run: Run) -> list[str]:
    """A run as a line of the list."""
    record = run.view()
    parts = [str(record[key]) for key in ("id", "kind", "name", "status", "profile")]
    return [
        *parts,
        f"{record['minutes']:.1f}",
        ",".join(record.get("tags", [])),
        record["error"] or digest(record),
    ]


def digest(record: dict[str, Any]) -> str:
    """Who flew where, in an evaluation, and the figures people look for first."""
    figures = []
    for key, label in (("sr", "SR"), ("cfr", "CFR"), ("fm", "FM"), ("steps", "steps")):
        value = record["result"].get(key)
        if value is not None:
            figures.append(f"{label} {value:,}" if isinstance(value, int) else f"{label} {value:.3f}")
    who = f"{record['method']['name']} in {record['scenario']}" if record["kind"] == "eval" else ""
    return ": ".join(part for part in (who, ", ".join(figures)) if part)
