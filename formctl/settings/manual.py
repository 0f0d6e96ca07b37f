"""The manual is the YAML: every key of ``conf/`` with the comment that stands beside or above it."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from formctl.settings.faults import fault
from formctl.settings.paths import conf_dir

Comments = dict[str, str]
"""Dotted key to its comment; list positions are left out of the key."""


def comments(path: Path) -> Comments:
    """Comments of one YAML file's own keys, ``defaults`` left out; "" where a key has none."""
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    root = yaml.compose(text)
    found: Comments = {}
    for key, node, value in _keys(root):
        if key.split(".")[0] != "defaults":
            found[key] = found.get(key) or _comment(node, value, lines)  # a list explains its first entry
    return found


def explain(group: str, choice: str) -> Comments:
    """Comments of every key of a group: what the file says that introduces the key, then what this choice adds.

    A key that only neighbouring files comment is explained in their words.
    """
    found: Comments = {}
    for path in lineage(group, choice):
        for key, text in comments(path).items():
            before = found.get(key, "")
            found[key] = f"{before}; here: {text}" if before and text and text != before else before or text
    for path in sorted((conf_dir() / group).glob("*.yaml")):
        for key, text in ({} if fault(path) else comments(path)).items():  # another choice's fault is no matter here
            found[key] = found.get(key) or text
    return {key: text or ("label of this choice" if key == "name" else "") for key, text in found.items()}


def title(group: str, choice: str) -> str:
    """The sentence at the head of a group's file."""
    for line in (conf_dir() / group / f"{choice}.yaml").read_text(encoding="utf-8").splitlines():
        if line.startswith("# ") and not line.startswith("# @"):
            return line[2:]
    return ""


def lineage(group: str, choice: str) -> list[Path]:
    """The file of a choice and, before it, the neighbours in the same group that its defaults list names."""
    path = conf_dir() / group / f"{choice}.yaml"
    if not path.exists():
        return []
    defaults = (yaml.safe_load(path.read_text(encoding="utf-8")) or {}).get("defaults", [])
    parents = [
        parent for name in defaults if isinstance(name, str) and name != "_self_" for parent in lineage(group, name)
    ]
    return [*parents, path]


def _keys(node: Any, prefix: str = "") -> Iterator[tuple[str, yaml.Node, yaml.Node]]:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            dotted = f"{prefix}{key.value}"
            yield dotted, key, value
            yield from _keys(value, f"{dotted}.")
    elif isinstance(node, yaml.SequenceNode):
        for item in node.value:
            yield from _keys(item, prefix)


def _comment(key: yaml.Node, value: yaml.Node, lines: list[str]) -> str:
    """The comment on the key's line, behind its value; otherwise the comment lines directly above."""
    nested = isinstance(value, yaml.MappingNode | yaml.SequenceNode) and not value.flow_style
    end = key.end_mark if nested else value.end_mark
    beside = re.search(r"#\s*(.*)$", lines[end.line][end.column :])
    if beside:
        return beside.group(1).strip()
    above: list[str] = []
    row = key.start_mark.line - 1
    while row >= 0 and lines[row].lstrip().startswith("# "):
        above.insert(0, lines[row].lstrip()[2:].strip())
        row -= 1
    return "" if row < 0 else " ".join(above)  # comments at the very top are the file's, not the key's


def rows(tree: dict[str, Any], chosen: dict[str, str]) -> list[tuple[str, str, str]]:
    """(key, value, meaning) of composed settings in their order; ``chosen`` names the file of every part of them."""
    meaning = {key: text for key, text in comments(conf_dir() / "config.yaml").items() if text}
    choices: dict[str, str] = {}
    for part, choice in sorted(chosen.items(), key=lambda item: item[0].count(".")):  # parts of parts come last
        group, _, package = part.partition("@")
        place = package or group
        if choice == "None" or group in ("profile", "experiment"):  # they set keys of other groups
            continue
        choices[place] = choice
        if not (conf_dir() / group / f"{choice}.yaml").exists():
            continue
        meaning[place] = title(group, choice)
        meaning |= {f"{place}.{key}": text for key, text in explain(group, choice).items()}
    shown = []
    for key, value in _leaves(tree):
        if key in choices or not isinstance(value, dict):
            shown.append((key, choices.get(key, _inline(value)), _meaning(key, meaning)))
    return shown


def _leaves(node: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every key and value, parents before children; a list of plain values is one value."""
    items = enumerate(node) if isinstance(node, list) else node.items()
    for key, value in items:
        nested = isinstance(value, dict) or (isinstance(value, list) and any(isinstance(item, dict) for item in value))
        if not nested or isinstance(value, dict):
            yield f"{prefix}{key}", value
        if nested:
            yield from _leaves(value, f"{prefix}{key}.")


def _meaning(key: str, meaning: Comments) -> str:
    """The comment of a key; of its parent where it has none (entries of free-form tables)."""
    plain = ".".join(part for part in key.split(".") if not part.isdigit())
    parent = plain.rpartition(".")[0]
    return meaning.get(key) or meaning.get(plain) or ("" if parent.count(".") < 1 else meaning.get(parent, ""))


def _inline(value: Any) -> str:
    return json.dumps(value) if not isinstance(value, str) else value
