import json
from pathlib import Path

import pandas as pd
import pytest

from analysis.data import rows, runs
from tests.analysis.synthetic import Made, episodes, trials


def test_a_missing_store_is_empty_and_a_file_is_none(tmp_path: Path) -> None:
    store = rows.load(tmp_path / "nothing")
    assert (store.runs, store.problems, store.profiles()) == ((), (), [])
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="is not a folder"):
        rows.load(tmp_path / "file")


def test_everything_comes_back(made: Made) -> None:
    policy = made.training(seed=4)
    flown = made.evaluation(made.policy(policy), episodes(30, 0.8))
    made.evaluation(made.baseline("hover"), episodes(20, 0.0))
    study = made.run("search", "stage1")
    trials(5).to_parquet(study / "trials.parquet")
    store = rows.load(made.root)
    assert store.problems == ()
    assert len(store.episodes) == 50
    assert store.episodes["eval_run"].value_counts()[flown.name] == 30
    assert list(store.trials["trial"]) == [0, 1, 2, 3, 4]
    assert set(store.logs) == {policy} and len(store.logs[policy]) == 60
    assert store.run(flown.name).method == runs.read_run(flown).method
    facts = store.run(flown.name).method
    assert facts is not None and (facts.seed, facts.run, facts.steps) == (4, policy, 6_000_000)
    assert store.run(flown.name).commit == "38e1a72"


def test_files_of_different_columns_are_stacked(made: Made) -> None:
    made.evaluation(made.baseline("hover"), episodes(3, 0.0).assign(min_ball=0.3))
    made.evaluation(made.baseline("straight_line"), episodes(4, 0.5))
    frame = rows.load(made.root).episodes
    assert frame["min_ball"].notna().sum() == 3


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "is not readable JSON"),
        ("[]", "an object was expected, found list"),
        ('{"schema": 1}', "'kind' is missing"),
        ('{"schema": 2, "kind": "eval", "name": "a", "id": "b", "status": "done", "profile": "p"}', "schema 2"),
        ('{"schema": 1, "kind": "oven", "name": "a", "id": "b", "status": "done", "profile": "p"}', "kind 'oven'"),
        (
            '{"schema": 1, "kind": "eval", "name": "a", "id": "b", "status": "done", "profile": "p", '
            '"method": {"steps": "x"}}',
            "'method' is not readable",
        ),
    ],
)
def test_a_damaged_record_is_named_in_one_line(made: Made, text: str, says: str) -> None:
    made.evaluation(made.baseline("hover"), episodes(3, 0.0))
    folder = made.root / "eval" / "x" / "y"
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(text)
    with pytest.raises(ValueError, match=says):
        runs.read_run(folder)
    store = rows.load(made.root)
    assert len(store.episodes) == 3
    (problem,) = store.problems
    assert says in problem and str(folder) in problem and "\n" not in problem


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda frame: frame.drop(columns="cfr"), "column 'cfr' is missing"),
        (lambda frame: frame.drop(columns="metric_version"), "column 'metric_version' is missing"),
        (
            lambda frame: frame.assign(cfr="yes"),
            "column 'cfr' is str, flag was expected",
        ),
        (lambda frame: frame.assign(columns=0.5), "column 'columns' is float64, integer was expected"),
        (lambda frame: frame.iloc[:0], "holds no episodes"),
        (lambda frame: frame.assign(fm=float("nan"), cfr=True), "is damaged"),
    ],
)
def test_foreign_rows_are_refused(made: Made, damage, says: str) -> None:
    path = made.evaluation(made.baseline("hover"), episodes(3, 0.0)) / "episodes.parquet"
    damage(pd.read_parquet(path)).to_parquet(path)
    with pytest.raises(ValueError, match=says):
        rows.read_episodes(path)
    assert len(rows.load(made.root).problems) == 1


def test_a_cut_file_is_refused(made: Made) -> None:
    path = made.evaluation(made.baseline("hover"), episodes(50, 0.0)) / "episodes.parquet"
    path.write_bytes(path.read_bytes()[:400])
    with pytest.raises(ValueError, match="is not a readable Parquet file"):
        rows.read_episodes(path)
    path.unlink()
    with pytest.raises(ValueError, match="is missing, though its run is recorded"):
        rows.read_episodes(path)


def test_unfinished_evaluations_are_left_out_and_named(made: Made) -> None:
    made.evaluation(made.baseline("hover"), episodes(3, 0.0), status="interrupted")
    store = rows.load(made.root)
    assert not store.tables
    assert "is interrupted: its episodes are left out" in store.problems[0]


def test_damaged_settings_leave_their_rows_out(made: Made) -> None:
    folder = made.evaluation(made.baseline("hover"), episodes(3, 0.0))
    (folder / "config.yaml").write_text("a: [1, 2")
    store = rows.load(made.root)
    assert not store.tables
    assert "is not readable YAML" in store.problems[0]


def test_a_log_may_end_in_the_middle_of_a_line_but_not_break_before(tmp_path: Path) -> None:
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"steps": 1}\n{"steps": 2}\n{"ste')
    assert rows.read_log(path)["steps"].tolist() == [1, 2]
    path.write_text('{"steps": 1}\nnonsense\n{"steps": 3}\n')
    with pytest.raises(ValueError, match="line 2"):
        rows.read_log(path)
    path.write_text('{"steps": 1}\n{"loss": 3}\n')
    with pytest.raises(ValueError, match="'steps' was expected"):
        rows.read_log(path)


def test_the_trainings_of_trials_are_known_but_draw_no_curves(made: Made) -> None:
    study = made.run("search", "stage1")
    trials(2).to_parquet(study / "trials.parquet")
    record = json.loads((study / "run.json").read_text()) | {"kind": "train", "id": "trial-run"}
    folder = study / "trials" / "0000"
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(json.dumps(record))
    (folder / "metrics.jsonl").write_text('{"steps": 1, "train/fm": 0.5}\n')
    store = rows.load(made.root)
    assert store.run("trial-run").trial
    assert not store.logs


def test_seriousness() -> None:
    assert sorted(["paper", "mine", "smoke", "laptop"], key=runs.seriousness) == ["smoke", "mine", "laptop", "paper"]
    assert runs.weakest({"paper", "smoke"}) == "smoke"
