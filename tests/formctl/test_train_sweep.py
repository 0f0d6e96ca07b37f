"""Several trainings in one call, and which weights stage 2 starts from."""

import pytest

from formctl import store
from formctl.errors import RunFailed
from formctl.stages import train

SWEEP = ("train", "-m", "seed=0,1,2", "train.steps=96", "curriculum=none")


def test_the_same_sweep_finishes_what_is_missing(formctl, tmp_path, monkeypatch):
    """One member fails and keeps nobody from their turn; a second call trains that one only; a third one nothing."""
    fit = train.fit

    def fail_first(run, config):
        if config.seed == 0:
            raise RunFailed("a bad day")
        fit(run, config)

    monkeypatch.setattr(train, "fit", fail_first)
    first = formctl(*SWEEP)
    assert first.code == 1 and "1 of 3 trainings failed; the same command again" in first.err.splitlines()[-1]
    assert sorted(run.record["seed"] for run in store.scan(tmp_path, kind="train", status="done")) == [1, 2]
    monkeypatch.undo()
    second = formctl(*SWEEP)
    assert second.code == 0 and second.out.count("there already") == 2, second.err
    assert sorted(run.record["seed"] for run in store.scan(tmp_path, kind="train")) == [0, 1, 2]
    third = formctl(*SWEEP)
    assert third.code == 0 and third.out.count("there already") == 3


def test_every_member_is_checked_before_the_first_begins(formctl, tmp_path):
    answer = formctl("train", "-m", "seed=0,-1")
    assert answer.code == 2 and answer.line == "seed=-1 cannot be used: it should be greater than or equal to 0"
    assert list(tmp_path.iterdir()) == []


def test_stage_2_takes_the_winner_of_the_newest_search_of_its_task(formctl_stocked, stocked):
    answer = formctl_stocked("train", "train.steps=96", "name=second")
    assert answer.code == 0, answer.err
    study, run = store.resolve("stage1", stocked), store.resolve("second", stocked)
    assert "weights: trial " in answer.out and "of stage1, SR " in answer.out and "on fresh episodes" in answer.out
    assert run.record["parents"] == [study.id] and run.config["weights"]["name"].startswith("@")


@pytest.mark.parametrize("words", [("weights=uniform",), ("curriculum=none",), ("reward=smooth",)])
def test_weights_of_another_task_or_another_wish_are_not_taken(stocked, tiny, words):
    config, origin = train.compose_training([*tiny, f"runs={stocked}", *words])
    assert "trial" not in origin and not config.tree["weights"]["name"].startswith("@")
