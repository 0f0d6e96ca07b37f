"""The commands that a report prints can be typed: they name real commands, options, groups and keys."""

import shlex
from pathlib import Path

import pytest

from analysis import evidence, report, rows
from analysis.plates import Gap
from formctl.cli import COMMANDS
from formctl.config import compose, expand_sweep
from tests.analysis.synthetic import Made, episodes


def printed(root: Path) -> set[str]:
    page = report.compose(evidence.gather(rows.load(root), baselines=["hover", "straight_line"]))
    found = {command for table in page.tables() for command in table.commands} | {page.fill}
    for section in page.sections:
        found |= set(section.commands)
        found |= {command for item in section.content if isinstance(item, Gap) for command in item.commands}
    return found


def overrides(command: str) -> list[tuple[str, ...]]:
    """What a command would compose, one entry per combination of a sweep."""
    program, name, *words = shlex.split(command)
    assert (program, name in COMMANDS) == ("formctl", True)
    keys = []
    while words:
        word = words.pop(0)
        if word in ("--policy", "--baseline", "--grid", "--record"):
            words.pop(0)
        elif word not in ("-m", "--curves"):
            keys.append(word)
    return [tuple(combination) for combination in expand_sweep(keys)]


@pytest.mark.parametrize("measured", [False, True])
def test_every_command_composes(made: Made, measured: bool) -> None:
    if measured:
        made.evaluation(made.policy(made.training(log=False)), episodes(5, 0.5))
    found = printed(made.root)
    assert len(found) >= 9
    composed = {keys for line in found for command in line.split(" && ") for keys in overrides(command)}
    for keys in sorted(composed):
        compose(list(keys))
