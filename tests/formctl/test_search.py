"""``formctl search``: totals, resumption, failures and refusals, with real trials of a few updates."""

import shutil
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import optuna
import pandas as pd
import pytest
from optuna.exceptions import StorageInternalError

from formctl import store
from formctl.search import dashboard, database, laws, winner, worker
from formctl.search import table as trials
from formctl.search.study import WeightStudy

ROOT = Path(__file__).parents[2]
METHODS = ("GET", "POST", "PUT", "PATCH", "DELETE")


def table(run: store.Run):
    return trials.read_table(run.path)


def test_trials_is_the_total(formctl, only):
    assert formctl("search", "--trials", "1").code == 0
    first = table(only("search")).iloc[0]
    again = formctl("search", "--trials", "2")
    assert again.code == 0 and "1 of 2 done, 1 to go" in again.out
    after = table(only("search"))
    assert list(after["state"]) == ["done", "done"]
    assert after.iloc[0].equals(first)  # what was finished is not touched
    assert [trials.weights(row) for _, row in after.iterrows()] == [
        laws.weights(0, number, "dirichlet") for number in (0, 1)
    ]
    third = formctl("search", "--trials", "2")
    assert third.code == 0 and "all 2 trials are there already" in third.out
    assert table(only("search")).equals(after)


def test_what_a_trial_keeps(stocked):
    run = store.resolve("stage1", stocked)
    row = table(run).iloc[1]
    assert (row["sr_n"], row["steps"], row["seed"]) == (3, 64, 0)
    assert row["sr"] == row["sr_k"] / row["sr_n"]
    assert row["minutes"] > 0 and (run.path / row["policy"]).is_file()
    trial = store.Run.open(run.path / "trials" / "0001")
    assert trial.status == "done" and trial.record["parents"] == [run.id]
    assert trial.record["result"]["sr"] == row["sr"]
    assert trial.config["scenario"]["name"] == "stage1"
    assert [entry["steps"] for entry in trial.metrics()] == [32, 64]
    assert run.record["result"]["done"] == 2 and run.record["bank"] is not None


def test_optuna_reads_the_study(stocked):
    run = store.resolve("stage1", stocked)
    (name,) = optuna.get_all_study_names(f"sqlite:///{run.path / 'study.db'}")
    study = optuna.load_study(study_name=name, storage=f"sqlite:///{run.path / 'study.db'}")
    assert [trial.value for trial in study.trials] == list(table(run)["sr"])
    assert study.trials[0].user_attrs["sr_n"] == 3
    assert set(study.trials[0].params) == set(laws.PARAMETERS)


def test_interrupted_search_goes_on_in_the_middle_of_a_trial(formctl, only, monkeypatch):
    hear = worker.StudyWorker.hear

    def interrupt(self, asked, note):
        hear(self, asked, note)
        if (asked.trial, note["steps"]) == (1, 32):
            raise KeyboardInterrupt

    monkeypatch.setattr(worker.StudyWorker, "hear", interrupt)
    stopped = formctl("search", "train.checkpoint_minutes=1e-9")
    assert stopped.code == 130 and "the same command again" in stopped.line
    run = only("search")
    assert run.status == "interrupted" and list(table(run)["state"]) == ["done", "running"]
    monkeypatch.undo()
    resumed = formctl("search")
    assert resumed.code == 0 and "1 of 2 done, 1 to go" in resumed.out
    assert run.status == "done" and list(table(run)["state"]) == ["done", "done"]


def test_failed_trials_are_recorded_and_do_not_stop_the_others(formctl, only, monkeypatch):
    run_trial = worker.run_trial

    def fail_first(asked, emit):
        if asked.trial == 0:
            raise RuntimeError("loss is not finite")
        return run_trial(asked, emit)

    monkeypatch.setattr(worker, "run_trial", fail_first)
    answer = formctl("search")
    assert answer.code == 0 and "trial 0 failed: RuntimeError: loss is not finite" in answer.err
    rows = table(only("search"))
    assert list(rows["state"]) == ["failed", "done"] and rows["error"][0] == "RuntimeError: loss is not finite"
    assert only("search").record["result"]["trial"] == 1


def test_a_study_without_a_finished_trial_is_a_failed_run(formctl, only, monkeypatch):
    def fail(asked, emit):
        raise RuntimeError("no")

    monkeypatch.setattr(worker, "run_trial", fail)
    answer = formctl("search")
    assert answer.code == 1 and "all 2 trials failed" in answer.err
    assert only("search").status == "failed"
    again = formctl("search")
    assert again.code == 1 and "all 2 trials failed" in again.err


def test_settings_that_contradict_each_other_leave_no_folder(formctl, tmp_path):
    answer = formctl("search", "search.steps=16")
    assert answer.code == 2 and "less than one update" in answer.line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("reward=release",), "has other settings (reward.name was shaped, is now release"),
        (("search.steps=96",), "search.steps was 64, is now 96"),
        (("seed=4",), "seed was 0, is now 4"),
        (("search.sampler=release",), "rule was dirichlet, is now release"),
    ],
)
def test_other_settings_are_refused(formctl_stocked, words, message):
    answer = formctl_stocked("search", *words)
    assert answer.code == 2 and message in answer.line and "type name=NAME for a new study" in answer.line


@pytest.mark.parametrize("count", ["0", "-3"])
def test_no_trials_is_a_wrong_call(formctl, tmp_path, count):
    answer = formctl("search", "--trials", count)
    assert answer.code == 2 and f"search.trials={count}" in answer.line
    assert list(tmp_path.iterdir()) == []


def test_status_and_best(stocked, formctl, call):
    status = call("search", "--status", f"runs={stocked}")
    assert status.code == 0 and "2 of 2 done, 0 to go" in status.out
    best = call("search", "--best", f"runs={stocked}")
    assert best.code == 0 and "take it on: formctl train curriculum=three_period weights=@stage1/best" in best.out
    assert "of 3), weights" in best.out and "on a fresh bank" in best.out  # both rates
    nothing = formctl("search", "--status")
    assert nothing.code == 2 and "no search run 'stage1'" in nothing.line


def test_the_winner_alone_is_flown_on_a_bank_of_its_own(stocked):
    run = store.resolve("stage1", stocked)
    rows = table(run)
    best = winner.choose(trials.read_rows(run.path))
    flown = rows["sr_fresh"].notna()
    assert list(rows.loc[flown, "trial"]) == [best["trial"]] and best["sr_fresh_n"] == 4
    fresh = pd.read_parquet((run.path / best["policy"]).with_name("fresh.parquet"))
    assert len(fresh) == 4 and fresh["bank"].iloc[0] != run.record["bank"]["sha256"]
    assert fresh["sr"].mean() == best["sr_fresh"] == run.record["result"]["sr_fresh"]


def test_top_and_sensitivity(stocked, call):
    top = call("search", "--top", "1", f"runs={stocked}")
    assert top.code == 0 and len(top.out.splitlines()) == 2
    answer = call("search", "--sensitivity", f"runs={stocked}")
    assert answer.code == 0 and "0.0036 (in use)" in answer.out
    rates = (store.resolve("stage1", stocked).path / "sensitivity.csv").read_text().splitlines()
    assert rates[0] == "formation_threshold,action_threshold,in_use,trial,sr"
    assert sum(",True," in line for line in rates) == 2  # both trials at the thresholds in use


def test_the_first_lines_say_what_is_searched_with(formctl):
    out = formctl("search", "--trials", "1").out
    assert "learner mappo, reward" in out and "observation" in out
    assert "weights: dirichlet, study seed 0, one vector per trial" in out
    assert "about to run 1 x 64 steps of stage1 and 3 episodes each" in out
    assert "winner: trial 0, SR" in out and "formctl train curriculum=three_period weights=@stage1/best" in out


def test_the_best_are_trained_again_with_other_seeds(formctl, only, monkeypatch):
    words = ("search", "search.confirm={trials: 1, seeds: 2, budget: 2}")
    told = []
    hear = worker.StudyWorker.hear

    def interrupt(self, asked, note):
        hear(self, asked, note)
        told.append(asked.label)
        if asked.label.endswith("seed 2"):
            raise KeyboardInterrupt

    monkeypatch.setattr(worker.StudyWorker, "hear", interrupt)
    assert formctl(*words).code == 130
    run = only("search")
    best = winner.by_rate(trials.read_rows(run.path))[0]["trial"]
    assert f"trial {best}, seed 1" in told
    monkeypatch.undo()
    again = formctl(*words)
    assert again.code == 0 and "all 2 trials are there already" in again.out, again.err
    assert (
        f"trial {best}, seed 1" not in again.out and "trained again with 2 other seeds, on the fresh bank" in again.out
    )
    row = trials.read_rows(run.path)[best]
    assert (row["seeds_again"], row["sr_again_n"]) == (2, 8) and run.status == "done"
    records = [store.Run(run.path / "trials" / f"{best:04d}-seed{seed}-128").record for seed in (1, 2)]
    assert [record["seed"] for record in records] == [1, 2]
    assert {record["result"]["steps"] for record in records} == {128}
    third = formctl(*words)
    assert third.code == 0 and "training the best" not in third.out


def test_a_reader_that_leaves_is_no_failure_of_the_trials(tiny, tmp_path):
    """As ``| head -1`` does: the study goes on to its end."""
    words = [sys.executable, "-m", "formctl", "search", *tiny, f"runs={tmp_path}", "engine.jobs=1"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as search:
        assert search.stdout is not None and search.stderr is not None
        search.stdout.readline()
        search.stdout.close()
        assert search.stderr.read() == "" and search.wait() == 0
    assert list(table(store.scan(tmp_path, kind="search")[0])["state"]) == ["done", "done"]


def test_failed_trials_are_retried_when_asked(formctl, only, monkeypatch):
    run_trial = worker.run_trial

    def fail_first(asked, emit):
        if asked.trial == 0:
            raise RuntimeError("no memory")
        return run_trial(asked, emit)

    monkeypatch.setattr(worker, "run_trial", fail_first)
    assert formctl("search").code == 0
    monkeypatch.undo()
    assert "all 2 trials are there already" in formctl("search").out
    again = formctl("search", "--retry-failed")
    assert again.code == 0 and "failed trials to try once more: 1" in again.out
    assert list(table(only("search"))["state"]) == ["done", "done"] and table(only("search"))["error"].isna().all()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--storage", "postgresql://u:secret@127.0.0.1:1/d"), "cannot be used"),
        (("--storage", "mysql://u:secret@h/d"), "mysql:// is not supported"),
        (("--worker", "stage1"), "--worker stage1 needs the shared storage"),
    ],
)
def test_storages_that_lead_nowhere_leave_no_folder(formctl, tmp_path, words, message):
    answer = formctl("search", *words)
    assert answer.code == 2 and message in answer.line and "secret" not in answer.line
    assert list(tmp_path.iterdir()) == []


def test_a_dashboard_follows_the_study_and_changes_nothing(stocked, tmp_path):
    shutil.copytree(store.resolve("stage1", stocked).path, folder := tmp_path / "study")
    url = database.sqlite(folder / "study.db")
    backend = database.open_storage(database.read_only(url))
    (shown,) = backend.get_all_studies()
    first, second = backend.get_all_trials(shown._study_id)
    assert {"ok_formation", "ok_action", "sr_k", "sr_n", "run", "policy"} <= set(first.user_attrs)
    assert first.value is not None and second.value is not None
    study = WeightStudy(folder, url)
    study.fail(study.claim(3), "no")
    assert len(backend.get_all_trials(shown._study_id)) == 3
    with pytest.raises(StorageInternalError):
        backend.delete_study(shown._study_id)


def test_a_dashboard_refuses_whatever_would_change_something():
    seen = []
    reading = dashboard.reading_only(lambda request, start: [b"page"])
    ask = {method: reading({"REQUEST_METHOD": method}, lambda *head: seen.append(head[0])) for method in METHODS}
    assert ask.pop("GET") == [b"page"]
    assert set(map(tuple, ask.values())) == {(dashboard.REFUSAL,)} and set(seen) == {"405 Method Not Allowed"}


def test_a_dashboard_finds_a_port():
    with ExitStack() as open_servers:
        one = open_servers.enter_context(dashboard.server(lambda request, start: [], 0))
        other = open_servers.enter_context(dashboard.server(lambda request, start: [], one.server_port))
        assert other.server_port != one.server_port
