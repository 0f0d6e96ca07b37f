"""The whole pipeline as its user runs it: real processes, an empty folder, killed without warning and started again."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from formctl import store
from formctl.search import laws, table, winner

ROOT = Path(__file__).resolve().parents[2]
TINY = [
    "profile=smoke",
    "algo=mappo_fast",
    "reward=shaped",
    "engine.jobs=1",
    "logger=none",
    "algo.envs=8",
    "algo.rollout=4",
    "algo.epochs=1",
    "algo.minibatches=2",
    "algo.pool=16",
    "search.trials=2",
    "search.steps=320",
    "search.episodes=3",
    "search.fresh_episodes=3",
    "train.steps=960",
    "train.judge_steps=1_000_000",
    "train.judge_episodes=2",
    "train.checkpoint_minutes=1e-9",
    "eval.episodes=3",
    "eval.seconds=0.5",
    "eval.time_limit=0.4",
]
"""Every stage for real; a checkpoint after every update of 32 steps."""


def start(folder: Path, *words: str) -> "subprocess.Popen[str]":
    """``formctl`` as a process of its own in ``folder``."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    return subprocess.Popen(
        [sys.executable, "-m", "formctl", *words],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def kill_when(process: "subprocess.Popen[str]", moment: Callable[[], bool]) -> None:
    """SIGKILL as soon as ``moment`` has come. Fails the test when the process ends before."""
    while not moment():
        assert process.poll() is None, process.communicate()[0]
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.communicate()


def finish(process: "subprocess.Popen[str]") -> str:
    out, _ = process.communicate()
    assert process.returncode == 0, out
    return out


def logged(run_folders: list[Path], updates: int) -> bool:
    """Whether one of the runs has saved a checkpoint and logged that many updates."""
    return any(
        (folder / "checkpoints" / "latest.pt").exists() and len(store.Run(folder).metrics()) >= updates
        for folder in run_folders
    )


@pytest.mark.timeout(1800)
def test_reproduce_survives_being_killed_and_never_works_twice(tmp_path):
    runs = tmp_path / "runs"
    words = ["reproduce", *TINY]

    kill_when(start(tmp_path, *words), lambda: logged([*runs.glob("search/smoke/*/trials/0001")], 5))
    (search,) = store.scan(runs, kind="search")
    assert search.status == "interrupted" and search.record["status"] == "running"
    assert [row["state"] for row in table.read_rows(search.path)] == ["done", "running"]
    first = table.read_rows(search.path)[0]

    kill_when(start(tmp_path, *words), lambda: logged([*runs.glob("train/smoke/*")], 5))
    (train,) = store.scan(runs, kind="train")
    assert search.status == "done" and train.status == "interrupted"
    rows = table.read_rows(search.path)
    kept = {key: value for key, value in first.items() if value is not None}  # the winner's fresh flight adds columns
    assert kept.items() <= rows[0].items() and [row["state"] for row in rows] == ["done", "done"]
    assert [table.weights(row) for row in rows] == [laws.weights(0, number, "dirichlet") for number in (0, 1)]
    interrupted_trial = store.Run(search.path / "trials" / "0001")
    assert [row["steps"] for row in interrupted_trial.metrics()] == list(range(32, 321, 32))

    out = finish(start(tmp_path, *words))
    assert "all 2 trials are there already" in out and "going on with" in out
    assert [run.path for run in store.scan(runs, kind="train")] == [train.path]
    assert train.status == "done" and train.record["parents"] == [search.id]
    assert tuple(train.record["method"]["weights"]) == table.weights(winner.choose(rows))
    assert [row["steps"] for row in train.metrics()] == list(range(32, 961, 32))
    (reproduction,) = store.scan(runs, kind="reproduce")
    assert reproduction.status == "done" and train.id in reproduction.record["parents"]
    (report,) = runs.glob("report/smoke/*/report.html")
    assert f"report: {report.relative_to(tmp_path)}" in out and "0.89" in out  # the paper's figure beside ours

    flown = len(store.scan(runs, kind="eval", status="done"))
    assert flown == 5
    again = finish(start(tmp_path, *words))
    assert again.count("there already") == 2 + flown  # study, training, evaluations
    assert len(store.scan(runs, kind="eval")) == flown


def test_demo_needs_nothing_but_an_empty_folder(tmp_path):
    out = finish(start(tmp_path, "demo", "eval.seconds=1"))
    assert "the policy that ships with formctl" in out and "goal not reached" in out
    assert (tmp_path / "formctl-demo.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "formctl-demo.mcap").read_bytes().startswith(b"\x89MCAP")
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".html", ".mcap", ".png"]
