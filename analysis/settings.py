"""Settings of many runs, each said once: what a kind's runs share, and what a method's and a run has instead."""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from analysis.records import Run


@dataclass(frozen=True)
class Own:
    """A run and what it has instead of its family's settings."""

    run: Run
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Family:
    """The runs of one method, and what most of them have instead of what their kind shares."""

    name: str
    lines: tuple[str, ...]
    runs: tuple[Own, ...]


@dataclass(frozen=True)
class Kind:
    """Runs of one kind, and the settings that most of them share, a line each: ``group.key: JSON value``."""

    name: str
    lines: tuple[str, ...]
    families: tuple[Family, ...]


def told(runs: Sequence[Run]) -> tuple[Kind, ...]:
    """The settings of all runs by kind and method, in the order of the runs."""
    trees = {run.id: leaves(_config(run)) for run in runs}
    kinds = []
    for name, alike in _grouped(runs, lambda run: run.kind).items():
        shared = usual([trees[run.id] for run in alike])
        families = []
        for method, members in _grouped(alike, family).items():
            common = usual([trees[run.id] for run in members])
            own = tuple(Own(run, instead(trees[run.id], common)) for run in members)
            families.append(Family(f"{name} {method}".strip(), instead(common, shared), own))
        kinds.append(Kind(name, tuple(f"{key}: {value}" for key, value in shared.items()), tuple(families)))
    return tuple(kinds)


def family(run: Run) -> str:
    """The method that a run trains or flies, by learner or baseline; a deployment is a family of its own."""
    facts = run.method
    who = "" if facts is None else facts.algo if facts.kind == "policy" else facts.name
    return ", ".join(filter(None, (who, "deployment" if _config(run).get("deploy") else "")))


def leaves(tree: Mapping[str, object], prefix: str = "") -> dict[str, str]:
    """A settings tree as ``{"group.key": JSON value}``, in its order; lists are values."""
    flat: dict[str, str] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping) and value:
            flat |= leaves(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = json.dumps(value, ensure_ascii=False, default=str)
    return flat


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


def _grouped(runs: Sequence[Run], name: Callable[[Run], str]) -> dict[str, list[Run]]:
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
