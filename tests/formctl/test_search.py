"""``formctl search``: totals, resumption, failures and refusals, with real trials of a few updates."""

import shutil
from contextlib import ExitStack

import pytest

from formctl import store
from formctl.search import sitting, trials

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
    assert [trials.row_weights(row) for _, row in after.iterrows()] == [
        trials.weights(0, number, "dirichlet") for number in (0, 1)
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
    import optuna

    run = store.resolve("stage1", stocked)
    (name,) = optuna.get_all_study_names(f"sqlite:///{run.path / 'study.db'}")
    study = optuna.load_study(study_name=name, storage=f"sqlite:///{run.path / 'study.db'}")
    assert [trial.value for trial in study.trials] == list(table(run)["sr"])
    assert study.trials[0].user_attrs["sr_n"] == 3
    assert set(study.trials[0].params) == set(trials.PARAMETERS)


def test_interrupted_search_goes_on_in_the_middle_of_a_trial(formctl, only, monkeypatch):
    hear = sitting.Sitting.hear

    def interrupt(self, asked, note):
        hear(self, asked, note)
        if (asked.trial, note["steps"]) == (1, 32):
            raise KeyboardInterrupt

    monkeypatch.setattr(sitting.Sitting, "hear", interrupt)
    stopped = formctl("search", "train.checkpoint_minutes=1e-9")
    assert stopped.code == 130 and "the same command again" in stopped.line
    run = only("search")
    assert run.status == "interrupted" and list(table(run)["state"]) == ["done", "running"]
    monkeypatch.undo()
    resumed = formctl("search")
    assert resumed.code == 0 and "1 of 2 done, 1 to go" in resumed.out
    assert run.status == "done" and list(table(run)["state"]) == ["done", "done"]


def test_failed_trials_are_recorded_and_do_not_stop_the_others(formctl, only, monkeypatch):
    run_trial = sitting.run_trial

    def fail_first(asked, emit):
        if asked.trial == 0:
            raise RuntimeError("loss is not finite")
        return run_trial(asked, emit)

    monkeypatch.setattr(sitting, "run_trial", fail_first)
    answer = formctl("search")
    assert answer.code == 0 and "trial 0 failed: RuntimeError: loss is not finite" in answer.err
    rows = table(only("search"))
    assert list(rows["state"]) == ["failed", "done"] and rows["error"][0] == "RuntimeError: loss is not finite"
    assert only("search").record["result"]["trial"] == 1


def test_a_study_without_a_finished_trial_is_a_failed_run(formctl, only, monkeypatch):
    def fail(asked, emit):
        raise RuntimeError("no")

    monkeypatch.setattr(sitting, "run_trial", fail)
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
        (("reward=release",), "has other settings (reward.target was envs.reward.ShapedReward"),
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
    assert best.code == 0 and "take it on: formctl train weights=@stage1/best" in best.out
    assert "of 3), weights" in best.out and "on a fresh bank" in best.out  # both rates
    nothing = formctl("search", "--status")
    assert nothing.code == 2 and "no search run 'stage1'" in nothing.line


def test_the_winner_alone_is_flown_on_a_bank_of_its_own(stocked):
    run = store.resolve("stage1", stocked)
    rows = table(run)
    winner = trials.best(rows)
    flown = rows["sr_fresh"].notna()
    assert list(rows.loc[flown, "trial"]) == [winner["trial"]] and winner["sr_fresh_n"] == 4
    import pandas as pd

    fresh = pd.read_parquet((run.path / winner["policy"]).with_name("fresh.parquet"))
    assert len(fresh) == 4 and fresh["bank"].iloc[0] != run.record["bank"]["sha256"]
    assert fresh["sr"].mean() == winner["sr_fresh"] == run.record["result"]["sr_fresh"]


def test_top_and_sensitivity(stocked, call):
    top = call("search", "--top", "1", f"runs={stocked}")
    assert top.code == 0 and len(top.out.splitlines()) == 2
    answer = call("search", "--sensitivity", f"runs={stocked}")
    assert answer.code == 0 and "0.01 (in use)" in answer.out
    rates = (store.resolve("stage1", stocked).path / "sensitivity.csv").read_text().splitlines()
    assert rates[0] == "formation_threshold,action_threshold,in_use,trial,sr"
    assert sum(",True," in line for line in rates) == 2  # both trials at the thresholds in use


def test_failed_trials_are_retried_when_asked(formctl, only, monkeypatch):
    run_trial = sitting.run_trial

    def fail_first(asked, emit):
        if asked.trial == 0:
            raise RuntimeError("no memory")
        return run_trial(asked, emit)

    monkeypatch.setattr(sitting, "run_trial", fail_first)
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


def test_a_dashboard_follows_the_study_and_changes_nothing(stocked, tmp_path, monkeypatch):
    from formctl.search import dashboard, patience
    from formctl.search.study import Study

    monkeypatch.setattr(dashboard, "PAUSE", 0.0)
    monkeypatch.setattr(patience, "SHARE", 0)
    shutil.copytree(store.resolve("stage1", stocked).path, folder := tmp_path / "study")
    study = Study.open(folder)
    backend, refresh = dashboard.source(study.ledger, tmp_path)
    (shown,) = backend.get_all_studies()
    first, second = backend.get_all_trials(shown._study_id)
    assert {"ok_formation", "ok_action", "sr_k", "sr_n", "run", "policy"} <= set(first.user_attrs)
    assert first.value is not None and second.value is not None
    study.claim(3)
    refresh()
    assert len(backend.get_all_trials(shown._study_id)) == 3
    before = (folder / "study.db").read_bytes()
    backend.delete_study(shown._study_id)
    assert (folder / "study.db").read_bytes() == before


def test_a_dashboard_refuses_whatever_would_change_something():
    from formctl.search import dashboard

    seen, refreshed = [], []
    guarded = dashboard.guarded(lambda request, start: [b"page"], lambda: refreshed.append(1))
    ask = {method: guarded({"REQUEST_METHOD": method}, lambda *head: seen.append(head[0])) for method in METHODS}
    assert ask.pop("GET") == [b"page"] and len(refreshed) == 1
    assert set(map(tuple, ask.values())) == {(dashboard.REFUSAL,)} and set(seen) == {"405 Method Not Allowed"}


def test_a_dashboard_finds_a_port():
    from formctl.search import dashboard

    with ExitStack() as open_servers:
        one = open_servers.enter_context(dashboard.server(lambda request, start: [], 0))
        other = open_servers.enter_context(dashboard.server(lambda request, start: [], one.server_port))
        assert other.server_port != one.server_port
