"""A survey: its cells, what the store has of them, and going on where it stopped."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from formctl import store, survey
from formctl.config import compose
from tests.formctl.conftest import TINY, Call, run

PARTS = [
    'survey.parts.columns.words=["scenario=static"]',
    *(
        f"survey.parts.{part}.episodes={{}}"
        for part in ("mixed_mujoco", "balls", "columns_mujoco", "balls_mujoco", "balls_box", "deployment_planners")
    ),
    *(f"survey.parts.{part}.episodes={{}}" for part in ("deployment", "latency", "noise", "mass", "behaviour_columns")),
]
WORDS = [
    *TINY,
    "survey=paper",
    "survey.groups.planners=[]",
    "survey.groups.pictured=[]",
    "survey.groups.sanity=[hover,nobody]",
    *PARTS,
]
"""Three parts and the recorded one, flown by a policy and an agent or two."""


@pytest.fixture(scope="module")
def surveyed(stocked: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A store with one training in which the survey was flown, and what the call printed."""
    root = tmp_path_factory.mktemp("surveyed")
    shutil.copytree(stocked / "train", root / "train")
    answer = run("reproduce", *WORDS, f"runs={root}")
    assert answer.code == 0, answer.err
    return root, answer.out + answer.err


def test_every_cell_is_flown_once_and_a_missing_baseline_is_said(surveyed: tuple[Path, str]) -> None:
    root, text = surveyed
    assert "there is no baseline 'nobody' here" in text
    rows = pd.concat([pd.read_parquet(path) for path in root.glob("eval/*/*/episodes.parquet")])
    cells = rows.groupby(["method", "scenario", "columns", "balls", "ball_aim", "bank"]).size()
    flown = {(method, scenario) for method, scenario, *_ in cells.index}
    assert flown == {
        ("ours", "mixed"),
        ("ours", "static"),
        ("ours", "dynamic"),
        ("hover", "mixed"),
        ("straight_line", "static"),
        ("straight_line", "dynamic"),
    }
    assert set(rows.loc[rows["scenario"] == "mixed", "ball_aim"]) == {"drone", "box"}
    assert "report.html" in text


def test_the_same_call_again_flies_nothing_and_a_lost_cell_is_flown_again(surveyed: tuple[Path, str]) -> None:
    root, _ = surveyed
    config = compose([*WORDS, f"runs={root}"])
    plan = survey.plan(config, [*WORDS, f"runs={root}"])
    assert plan.missing == ()
    lost = store.scan(root, kind="eval", name="paper-columns")[0]
    kept = {cell.key for cell in plan.cells if plan.there[cell.key].path != lost.path}
    (lost.path / "episodes.parquet").rename(lost.path / "lost")
    again = survey.plan(config, [*WORDS, f"runs={root}"])
    (lost.path / "lost").rename(lost.path / "episodes.parquet")
    assert {cell.key for cell in plan.cells} - {cell.key for cell in again.missing} == kept
    assert len(again.missing) == 1


def test_plan_flies_nothing(stocked: Path, call: Call) -> None:
    before = len(store.scan(stocked))
    answer = call("reproduce", "--plan", *WORDS, f"runs={stocked}")
    assert answer.code == 0
    assert "cells have to be flown" in answer.out + answer.err
    assert len(store.scan(stocked)) == before


def test_rows_flown_by_hand_count(stocked: Path, tmp_path: Path) -> None:
    shutil.copytree(stocked / "train", tmp_path / "train")
    answer = run("eval", "--baseline", "hover", *TINY, "scenario=mixed", f"runs={tmp_path}")
    assert answer.code == 0, answer.err
    words = [*WORDS, f"runs={tmp_path}"]
    plan = survey.plan(compose(words), words)
    there = [(cell.part, cell.method.name) for cell in plan.cells if cell.key in plan.there]
    assert there == [("mixed", "hover")]


def test_a_group_that_is_none_is_refused_in_one_line(call: Call, tmp_path: Path) -> None:
    answer = call("reproduce", "survey=paper", "survey.parts.mixed.episodes={planets:3}", f"runs={tmp_path}")
    assert answer.code == 2
    assert "there is no group 'planets'" in answer.line
