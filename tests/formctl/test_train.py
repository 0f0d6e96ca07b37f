"""``formctl train``: what a training leaves behind, and how it ends in good and bad days."""

import errno
import os
import signal

import pytest
import torch

from algos import checkpoint
from algos.learner import TrainingDiverged
from algos.trainer import Trainer
from formctl import store, training
from formctl.search import laws, table, winner
from formctl.stages import train

LAST = 160


def weights_of(run: store.Run) -> dict[str, torch.Tensor]:
    return checkpoint.load(run.path / "policy.pt", kind="policy")["weights"]


def test_what_a_training_leaves_behind(stocked):
    run = store.resolve("ours", stocked)
    study = store.resolve("stage1", stocked)
    best = winner.choose(table.read_rows(study.path))
    method = run.record["method"]
    assert run.status == "done" and run.record["parents"] == [study.id]
    assert (method["name"], method["kind"], method["algo"], method["curriculum"]) == (
        "ours",
        "policy",
        "mappo",
        "three_period",
    )
    assert tuple(method["weights"]) == table.weights(best) and method["run"] == run.id
    assert run.record["result"]["steps"] == LAST and run.record["minutes"] > 0
    rows = run.metrics()
    assert [row["steps"] for row in rows] == list(range(32, LAST + 1, 32))
    assert rows[0]["period"] == "free" and rows[-1]["period"] == "mixed"
    assert "judge/cfr" in rows[-1] and "loss/policy" in rows[0]
    assert checkpoint.load(run.checkpoint("best"))["steps"] == LAST
    assert checkpoint.load(run.path / "policy.pt", kind="policy")["meta"]["method"] == method


def test_tensorboard_events_are_written_on_request(formctl, only):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    assert formctl("train", "logger=tensorboard", "train.steps=96").code == 0
    events = EventAccumulator(str(only("train").path / "tensorboard")).Reload()
    assert [event.step for event in events.Scalars("loss/policy")] == [32, 64, 96]


def test_no_tensorboard_events_without_it(formctl, only):
    assert formctl("train", "train.steps=96").code == 0
    assert not (only("train").path / "tensorboard").exists()


def test_an_interrupt_while_compiling_stops_at_once(formctl, only, monkeypatch):
    def endless(*args):
        os.kill(os.getpid(), signal.SIGTERM)
        raise AssertionError("an update went on")

    monkeypatch.setattr(torch, "compile", lambda function, **_: endless)
    stopped = formctl("train", "train.compile=true")
    run = only("train")
    assert stopped.code == 130 and stopped.line.startswith("interrupted while compiling"), stopped.err
    assert f"formctl train --resume {run.path}" in stopped.line
    assert run.status == "interrupted" and ": compiling " in stopped.out and ", 0 of " in stopped.out


def test_interrupt_saves_and_resume_ends_like_a_training_that_was_left_alone(formctl, call, tmp_path, monkeypatch):
    assert formctl("train", "name=alone").code == 0
    describe = train.note

    def interrupt(period, metrics):
        os.kill(os.getpid(), signal.SIGINT)
        return describe(period, metrics)

    monkeypatch.setattr(train, "note", interrupt)
    stopped = formctl("train", "name=stopped")
    run = store.resolve("stopped", tmp_path)
    assert stopped.code == 130
    assert "interrupted at 32 steps and saved" in stopped.line
    assert f"formctl train --resume {run.path}" in stopped.line
    assert run.status == "interrupted" and checkpoint.load(run.checkpoint())["steps"] == 32
    monkeypatch.undo()
    run.path.joinpath("metrics.jsonl").open("a").write('{"steps": 64, "torn')  # as a crash would leave it

    resumed = call("train", "--resume", run.id, f"runs={tmp_path}")
    assert resumed.code == 0, resumed.err
    assert run.status == "done"
    alone = store.resolve("alone", tmp_path)
    times = ("minutes", "steps_per_second")
    assert [{k: v for k, v in row.items() if k not in times} for row in run.metrics()] == [
        {k: v for k, v in row.items() if k not in times} for row in alone.metrics()
    ]
    ours, theirs = weights_of(run), weights_of(alone)
    assert all(torch.equal(ours[key], theirs[key]) for key in ours)


def test_a_diverged_training_keeps_its_last_good_checkpoint(formctl, only, monkeypatch):
    honest = Trainer.train

    def diverge(self):
        for number, progress in enumerate(honest(self)):
            if number == 2:
                raise TrainingDiverged({"steps": progress.steps, "loss/value": "nan"})
            yield progress

    monkeypatch.setattr(Trainer, "train", diverge)
    answer = formctl("train", "train.checkpoint_minutes=1e-9")
    run = only("train")
    assert (
        answer.code == 1 and "training diverged after 64 steps" in answer.line and str(run.checkpoint()) in answer.line
    )
    assert run.status == "failed" and "diverged" in run.record["error"]
    assert run.record["result"]["diverged"] == {"steps": 96, "loss/value": "nan"}
    assert checkpoint.load(run.checkpoint())["steps"] == 64


def test_a_full_disk_is_one_line_and_the_last_good_checkpoint_survives(formctl, only, monkeypatch):
    written = []
    write = checkpoint._write

    def run_full(path, data):
        if len(written) == 2:
            path.write_bytes(data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written.append(path)
        write(path, data)

    monkeypatch.setattr(checkpoint, "_write", run_full)
    answer = formctl("train", "train.checkpoint_minutes=1e-9")
    run = only("train")
    assert answer.code == 2 and "No space left on device" in answer.line
    assert f"make room; go on with: formctl train --resume {run.path}" in answer.line
    assert run.status == "failed"
    assert checkpoint.load(run.checkpoint())["steps"] == 64
    assert [path.name for path in run.checkpoint().parent.iterdir()] == ["latest.pt"]


def test_resume_refuses_what_cannot_be_resumed(stocked, call):
    done = call("train", "--resume", "ours", f"runs={stocked}")
    assert done.code == 2 and "is done already" in done.line
    changed = call("train", "--resume", "ours", "seed=3", f"runs={stocked}")
    assert changed.code == 2 and "leave out seed=3" in changed.line
    unknown = call("train", "--resume", "theirs", f"runs={stocked}")
    assert unknown.code == 2 and "no train run 'theirs'" in unknown.line and "train/ours" in unknown.line


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("stage1/trial=7", "has no trial 7"),
        ("stage1/first", "'first' is neither best nor trial=NUMBER"),
        ("stage1", "names no trial"),
        ("nostudy/best", "no search run 'nostudy'"),
    ],
)
def test_weights_that_no_study_has_are_refused(stocked, formctl_stocked, reference, message):
    before = len(store.scan(stocked))
    answer = formctl_stocked("train", f"weights=@{reference}")
    assert answer.code == 2 and message in answer.line
    assert len(store.scan(stocked)) == before


def test_weights_of_a_chosen_trial(stocked, formctl, tmp_path):
    study = store.resolve("stage1", stocked)
    answer = formctl("train", "train.steps=96", f"weights=@{study.path}/trial=1")
    assert answer.code == 0, answer.err
    assert tuple(store.resolve("main", tmp_path).record["method"]["weights"]) == laws.weights(0, 1, "dirichlet")


def test_sweeps_run_one_after_another(formctl, tmp_path):
    answer = formctl("train", "-m", "seed=0,1", "train.steps=96", "curriculum=none")
    assert answer.code == 0, answer.err
    assert sorted(run.record["seed"] for run in store.scan(tmp_path, kind="train", status="done")) == [0, 1]


def test_settings_that_contradict_each_other_leave_no_folder(formctl, tmp_path):
    answer = formctl("train", "algo.minibatches=5")
    assert answer.code == 2 and "algo.minibatches=5" in answer.line
    assert list(tmp_path.iterdir()) == []


def test_a_second_interrupt_stops_at_once():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt, match="stopped at once"), training.graceful() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.requested
        os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGINT) is before
