"""The commands that a report prints can be typed: they name real commands, options, groups and keys."""

import shlex
from pathlib import Path
from typing import Any

import pytest

from analysis import commands, evidence, report, rows
from analysis.plates import Gap
from formctl.cli import COMMANDS
from formctl.settings import compose, expand_sweep
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
        if word in ("--policy", "--baseline", "--grid", "--record", "--episodes"):
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


def test_commands_name_the_store_as_it_was_typed(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    made.evaluation(made.policy(made.training(log=False)), episodes(5, 0.5))
    parts = [part for line in printed(made.root) for part in line.split(" && ")]
    assert parts and all(f"runs={made.root}" in shlex.split(part) for part in parts)
    monkeypatch.chdir(made.root.parent)
    assert not any("runs=" in line for line in printed(Path("runs")))
    made.root.rename(made.root.with_name("my runs"))
    assert all("'runs=my runs'" in line for line in printed(Path("my runs")))


SHIPPED: dict[str, Any] = {"name": "dense", "run": "20251122T160017-1c3b"}


@pytest.mark.parametrize(
    ("argv", "who"),
    [
        (["--policy", "mixed"], "mixed"),
        (["--policy=kept/my policy.pt"], "'kept/my policy.pt'"),
        (["--policy", "ours", "--policy", "mixed"], "mixed"),
        (["--policy", "one", "--policy", "two"], "dense"),  # nothing tells which of them
        ([], "dense"),
    ],
)
def test_a_policy_trained_elsewhere_is_called_what_its_flight_called_it(made: Made, argv: list[str], who: str) -> None:
    call = ["formctl", "eval", *argv]
    facts = made.policy(made.training(log=False))
    made.evaluation(facts | SHIPPED | {"steps": 7}, episodes(5, 0.5), argv=call)
    if argv.count("--policy") == 2:
        made.evaluation(facts | {"name": "ours"}, episodes(5, 0.5), argv=call)
    found = evidence.gather(rows.load(made.root))
    shipped, *others = (method for method in found.methods.values() if method.facts.steps == 7)
    assert not others
    assert commands.fly(found, shipped, []).startswith(f"formctl eval --policy {who} profile=laptop")
    assert commands.deploy(found, shipped).startswith(f"formctl deploy --policy {who} profile=laptop")
