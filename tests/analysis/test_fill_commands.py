"""The commands that a report prints can be typed: they name real commands, options, groups and keys."""

import shlex
from pathlib import Path

import pytest
from synthetic import full_store

from analysis import evidence, report, rows
from analysis.plates import Gap
from formctl.cli import COMMANDS
from formctl.config import compose, expand_sweep


def printed(root: Path) -> set[str]:
    page = report.compose(evidence.gather(rows.load(root), baselines=["hover", "straight_line"]))
    found = {command for table in page.tables() for command in table.commands} | {page.fill}
    for section in page.sections:
        found |= set(section.commands)
        found |= {command for item in section.content if isinstance(item, Gap) for command in item.commands}
    return found


def check(command: str) -> None:
    program, name, *words = shlex.split(command)
    assert (program, name in COMMANDS) == ("formctl", True)
    overrides = []
    while words:
        word = words.pop(0)
        if word in ("--policy", "--baseline", "--grid"):
            words.pop(0)
        elif word != "-m":
            overrides.append(word)
    for combination in expand_sweep(overrides):
        compose(combination)


@pytest.mark.parametrize("measured", [False, True])
def test_every_command_composes(tmp_path: Path, measured: bool) -> None:
    if measured:
        full_store(tmp_path / "runs", count=5, seeds=[0])
    found = printed(tmp_path / "runs")
    assert len(found) >= (3 if measured else 10)
    for line in found:
        for command in line.split(" && "):
            check(command)
