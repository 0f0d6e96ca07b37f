"""Every example runs as it stands, on a budget of seconds, and what it makes can be flown."""

import json
import runpy
import sys
from pathlib import Path

import pytest

from formctl import cli
from tests.formctl.conftest import TINY, run

EXAMPLES = Path(__file__).parents[2] / "examples"
BUDGETS = {
    "ppo_gymnasium.py": ["--steps", "600", "--envs", "8"],
    "ppo_pettingzoo.py": ["--steps", "60", "--eager", "--rollout", "30"],
    "ppo_torchrl.py": ["--steps", "600", "--envs", "8"],
}


def test_every_example_has_a_test() -> None:
    own = {"own_planner.py", "rows.ipynb", "README.md"}
    assert {path.name for path in EXAMPLES.iterdir() if path.is_file()} == {*BUDGETS, *own}


@pytest.mark.parametrize("name", BUDGETS)
@pytest.mark.filterwarnings("ignore")
def test_a_learner_learns_and_its_policy_is_flown(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    policy, log = tmp_path / "free.pt2", tmp_path / "curve.jsonl"
    monkeypatch.setattr(sys, "argv", [name, *BUDGETS[name], "--out", str(policy), "--log", str(log)])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    curve = [json.loads(line) for line in log.read_text().splitlines()]
    assert [row["steps"] for row in curve] == sorted({row["steps"] for row in curve})
    assert len(curve) == 2
    store = f"runs={tmp_path / 'runs'}"
    answer = run("eval", "--policy", str(policy), "scenario=free", *TINY, store)
    assert answer.code == 0, answer.err
    assert f"\n{Path(name).stem} " in answer.out


def test_the_planner_flies_and_takes_settings(tmp_path: Path) -> None:
    target = f"{EXAMPLES / 'own_planner.py'}:PotentialField"
    store = f"runs={tmp_path / 'runs'}"
    answer = run("eval", "--baseline", target, "baseline.reach=2", "scenario=static", *TINY, store)
    assert answer.code == 0, answer.err
    assert "\nown_planner " in answer.out
    again = run("replay", "main:0", "--runs", str(tmp_path / "runs"), "--out", str(tmp_path / "again"))
    assert again.code == 0, again.err
    assert "differ" not in again.err


def test_the_planner_avoids_what_a_straight_line_hits(tmp_path: Path) -> None:
    words = ["eval", "scenario=static", "eval.episodes=16", "eval.compile=false", f"runs={tmp_path}", "logger=none"]
    target = f"{EXAMPLES / 'own_planner.py'}:PotentialField"
    assert cli.run([*words, "--baseline", target, "--out", str(tmp_path / "own.parquet")]) == 0
    assert cli.run([*words, "--baseline", "straight_line", "--out", str(tmp_path / "straight.parquet")]) == 0
    import pandas as pd

    own, straight = (pd.read_parquet(tmp_path / f"{name}.parquet")["cfr"].mean() for name in ("own", "straight"))
    assert own > straight + 0.2


def test_the_notebook_runs(tmp_path: Path) -> None:
    nbclient = pytest.importorskip("nbclient")
    import nbformat

    notebook = nbformat.read(EXAMPLES / "rows.ipynb", as_version=4)
    nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(EXAMPLES)}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in shown)
    assert not any(output["output_type"] == "error" for output in shown)


def test_the_notebook_is_kept_without_outputs() -> None:
    import nbformat

    cells = nbformat.read(EXAMPLES / "rows.ipynb", as_version=4).cells
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)
