"""What the documents say is what the program does."""

import re
from itertools import pairwise
from pathlib import Path

import pytest

from envs.bank import Bank
from formctl import cli
from formctl.evaluation import evaluate, methods, scenes
from formctl.settings import build, compose, expand_sweep

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCKS = [block for path in DOCUMENTS for block in re.findall(r"```sh\n(.*?)```", path.read_text(), re.DOTALL)]
CALLS = sorted(
    {line.partition("#")[0].strip() for block in BLOCKS for line in block.splitlines() if line.startswith("formctl ")}
)

VALUED = ("--record", "--vary")
"""Options whose values look like settings."""


def test_rows_md_describes_every_column_and_no_other() -> None:
    documented = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs" / "rows.md").read_text(), re.MULTILINE)
    config = compose(["scenario=mixed", "eval.seconds=0.04"])
    scene = scenes.EvaluationScene(build.world(config), Bank.create(config.scenario, 2, seed=0))
    rows = evaluate.evaluate(methods.baseline("hover", []), [scene], config)
    assert len(documented) == len(set(documented))
    assert set(documented) == set(rows.columns)


@pytest.mark.parametrize("call", CALLS)
def test_documented_calls_exist_and_compose(call: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = call.split()[1:]
    assert words[0] in cli.COMMANDS
    options = [word for word in words if word.startswith("-")]
    command = words[:2] if words[0] in ("bank", "conf", "runs") else words[:1]
    assert cli.run([*command, "--help"]) == 0
    page = capsys.readouterr().out
    assert all(option in page for option in options)
    settings = [word for before, word in pairwise(words) if re.match(r"[a-z@_.]+=", word) and before not in VALUED]
    if ".py:" in call:  # settings of a class in a file, which has no YAML
        settings = [word for word in settings if not word.startswith("baseline.")]
    for combination in expand_sweep(settings):
        compose(combination, lambda reference: (0.25, 0.25, 0.25, 0.25))


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(path: Path) -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", path.read_text())
    assert all(target.startswith("https://") or (path.parent / target).exists() for target in targets)
