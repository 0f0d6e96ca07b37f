"""Trackers: what was logged can be read back from each, offline; and every name is documented."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from formctl import store, trackers
from formctl.errors import ConfigError
from formctl.settings import compose
from formctl.settings.schema import LoggerSpec

ROWS = [{"steps": 32, "period": "free", "loss/policy": 0.5}, {"steps": 64, "period": "mixed", "loss/policy": 0.25}]
CALL = {"config": {"seed": 3}, "provenance": {}, "argv": ["formctl", "train"], "profile": "smoke", "seed": 3}


def spec(tracker: str) -> LoggerSpec:
    return LoggerSpec("test", tensorboard=False, tracker=tracker, project="tests")


def logged(root: Path, tracker: str) -> store.Run:
    """A run in which ROWS were logged in two sittings."""
    run = store.create(root, "train", "main", **CALL)
    for row in ROWS:
        with run.work() as live, trackers.opened(live, spec(tracker), 0) as track:
            track(row)
    assert [row["loss/policy"] for row in run.metrics()] == [0.5, 0.25]
    return run


def test_mlflow_has_one_run_with_both_sittings(tmp_path: Path) -> None:
    mlflow = pytest.importorskip("mlflow")
    run = logged(tmp_path, "mlflow")
    client = mlflow.MlflowClient(tracking_uri=f"sqlite:///{tmp_path / 'mlflow.db'}")
    (kept,) = client.search_runs([client.get_experiment_by_name("tests").experiment_id])
    assert kept.data.tags["formctl"] == run.id and kept.info.status == "FINISHED"
    assert [(m.step, m.value) for m in client.get_metric_history(kept.info.run_id, "loss/policy")] == [
        (32, 0.5),
        (64, 0.25),
    ]


def test_trackio_has_one_run_with_both_sittings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("trackio")
    import sqlite3

    import trackio.sqlite_storage

    monkeypatch.setattr(trackio.sqlite_storage, "TRACKIO_DIR", tmp_path)  # read when it was imported
    run = logged(tmp_path, "trackio")
    (file,) = tmp_path.glob("*.db")
    with sqlite3.connect(file) as database:
        found = database.execute("select run_name, step, metrics from metrics order by step").fetchall()
    assert [(name, step) for name, step, _ in found] == [(run.id, 32), (run.id, 64)]
    assert b"0.25" in found[1][2]


def test_wandb_is_offline_in_the_run_s_folder(tmp_path: Path) -> None:
    pytest.importorskip("wandb")
    run = logged(tmp_path, "wandb")
    files = sorted((run.path / "wandb").glob(f"offline-run-*/run-{run.id}.wandb"))
    assert files and all(b"loss/policy" in path.read_bytes() for path in files)


def test_a_tracker_that_is_not_installed_says_what_to_type(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formctl.extras.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"wandb is not installed: pip install 'formctl\[wandb\]'"):
        trackers.check(spec("wandb"))
    trackers.check(replace(spec("wandb"), tracker="", tensorboard=True))


@pytest.mark.parametrize("choice", ["none", "tensorboard", "wandb", "mlflow", "trackio"])
def test_nothing_leaves_the_machine_unless_asked(choice: str) -> None:
    logger = compose([f"logger={choice}"]).logger
    assert not logger.online
    assert trackers.names(logger) == ([] if choice == "none" else [choice])


def test_every_metric_is_documented(stocked: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "metrics.md").read_text()
    documented = set(re.findall(r"`([\w/]+)`", text))
    names = {name for row in store.resolve("ours", stocked).metrics() for name in row}
    assert names >= {"learn/reward", "loss/policy", "judge/cfr"}
    assert not {name for name in names if not name.startswith("period/")} - documented
