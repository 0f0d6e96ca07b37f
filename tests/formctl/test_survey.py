"""A survey: its cells, what the store has of them, and going on where it stopped."""

import json
import shutil
from pathlib import Path

import pandas as pd
import pytest
import yaml

from formctl import store
from formctl.errors import ConfigError
from formctl.evaluation import suite
from formctl.settings import compose
from formctl.settings.schema import PartSpec
from tests.formctl.conftest import TINY, Call, run

REFERENCE = next((Path(__file__).parents[2] / "runs" / "reference" / "train" / "dense").iterdir())
LEFT_OUT = (
    *("mixed_mujoco", "balls", "balls_box", "columns_mujoco", "balls_mujoco", "behaviour_columns", "behaviour_balls"),
    *("deployment", "deployment_planners", "latency", "noise", "mass"),
)
WORDS = [
    *TINY,
    "survey=paper",
    "survey.groups.sanity=[hover,nobody]",
    *(f"survey.groups.{group}=[]" for group in ("learnt", "fair", "published")),
    'survey.parts.columns.words=["scenario=static"]',
    *(f"survey.parts.{part}.words=[]" for part in LEFT_OUT),
]
"""Two parts, flown by a policy and an agent each."""


def trained(root: Path) -> Path:
    """The store with one finished training of the tests' profile in it."""
    folder = root / "train" / "ours" / REFERENCE.name
    shutil.copytree(REFERENCE, folder)
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(record | {"profile": "smoke"}))
    return root


@pytest.fixture(scope="module")
def surveyed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A store with one training in which the survey was flown, and what the call printed."""
    root = trained(tmp_path_factory.mktemp("surveyed"))
    answer = run("reproduce", *WORDS, f"runs={root}")
    assert answer.code == 0, answer.err
    return root, answer.out + answer.err


def test_every_cell_is_flown_once_and_a_missing_baseline_is_said(surveyed: tuple[Path, str]) -> None:
    root, text = surveyed
    assert "there is no baseline 'nobody' here" in text
    rows = pd.concat([pd.read_parquet(path) for path in root.glob("eval/*/*/episodes.parquet")])
    cells = rows.groupby(["method", "scenario", "ball_aim"]).size()
    assert set(cells) == {3}
    flown = {(method, scenario, aim) for method, scenario, aim in cells.index if scenario == "mixed"}
    assert flown == {(method, "mixed", aim) for method in ("dense", "hover") for aim in ("drone", "box")}
    assert set(rows.loc[rows["scenario"] == "static", "method"]) == {"dense", "straight_line"}
    assert "report.html" in text


def test_the_same_call_again_flies_nothing_and_a_lost_cell_is_flown_again(surveyed: tuple[Path, str]) -> None:
    root, _ = surveyed
    words = [*WORDS, f"runs={root}"]
    config = compose(words)
    plan = suite.plan(config, words)
    assert (len(plan.cells), plan.missing) == (6, ())
    lost = store.scan(root, kind="eval", name="paper-columns")[0]
    (lost.path / "episodes.parquet").rename(lost.path / "lost")
    again = suite.plan(config, words)
    (lost.path / "lost").rename(lost.path / "episodes.parquet")
    assert [cell.key for cell in again.missing] == [k for k, run in plan.stored.items() if run.path == lost.path]


def test_plan_flies_nothing_and_shipped_policies_stand_in(tmp_path: Path, call: Call) -> None:
    answer = call("reproduce", "--plan", *WORDS, f"runs={tmp_path}")
    assert answer.code == 0, answer.err
    assert "6 of 6 cells have to be flown: 18 episodes" in answer.out + answer.err
    assert "no finished training of profile smoke: shipped policies fly" in answer.out + answer.err
    assert not list(tmp_path.iterdir())


def test_rows_flown_by_hand_count(tmp_path: Path) -> None:
    trained(tmp_path)
    answer = run("eval", "--baseline", "hover", *TINY, "scenario=mixed", f"runs={tmp_path}")
    assert answer.code == 0, answer.err
    words = [*WORDS, f"runs={tmp_path}"]
    plan = suite.plan(compose(words), words)
    assert [(cell.part, cell.method.name) for cell in plan.cells if cell.key in plan.stored] == [("mixed", "hover")]


def test_of_seeds_the_newest_stands_for_all(tmp_path: Path) -> None:
    first = next((trained(tmp_path) / "train" / "ours").iterdir())
    for name, method, reward in (("2", {"seed": 1}, {}), ("3", {"seed": 2}, {}), ("4", {}, {"name": "other"})):
        folder = first.with_name(f"20261122T2222{name}0-0000")
        shutil.copytree(first, folder)
        record = json.loads((folder / "run.json").read_text())
        method = record["method"] | method
        (folder / "run.json").write_text(json.dumps(record | {"id": folder.name, "method": method}))
        if reward:
            tree = yaml.safe_load((folder / "config.yaml").read_text())
            (folder / "config.yaml").write_text(yaml.safe_dump(tree | {"reward": tree["reward"] | reward}))
    groups = suite.policies(compose([*WORDS, f"runs={tmp_path}"]), [])
    assert len(groups["policies"]) == 4
    assert groups["newest"] == groups["policies"][2:]


def test_arms_and_policies_for_flight_are_groups_of_their_own() -> None:
    config = compose(["survey=paper", "runs=runs/reference"])
    groups = {name: [method.name for method in found] for name, found in suite.policies(config, []).items()}
    assert set(groups["newest"]) == set(groups["policies"]) == {"three_period", "mappo_three_period", "dense"}
    assert {"no_sa", "no_ca", "mlp", "two_period", "no_curriculum", "three_period_dynamic"} < set(groups["arms"])
    assert groups["flight"] == ["sim_to_real"]


def test_a_group_that_is_none_is_refused() -> None:
    part = PartSpec(("scenario=mixed",), {"planets": 3})
    with pytest.raises(ConfigError, match="there is no group 'planets'; the groups are policies, sanity"):
        suite._check("mixed", part, {"policies": [], "sanity": []})
