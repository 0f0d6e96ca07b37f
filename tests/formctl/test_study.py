"""The search's record: totals, weights that depend on nothing but their number, and resumption."""

import sqlite3

import numpy as np
import pytest

from formctl.search import trials
from formctl.search.study import Study
from formctl.store.files import StoreError

SETTINGS = {"scenario": {"name": "stage1", "balls": 3}, "reward": {"name": "shaped"}}


def make(folder, rule="dirichlet"):
    folder.mkdir(exist_ok=True)
    return Study.create(folder, seed=5, rule=rule, settings=SETTINGS)


def tickets(study, total):
    """Claim until nothing is left to claim."""
    return iter(lambda: study.claim(total), None)


def outcome(sr=0.5, **more):
    return {"sr": sr, "sr_k": 5, "sr_n": 10, "cfr": 0.6, "fm": 0.3, "steps": 1000, "minutes": 0.1} | more


@pytest.mark.parametrize("rule", ["dirichlet", "release", "sobol"])
def test_weights_are_a_pure_function_on_the_simplex(rule):
    vectors = [trials.weights(3, trial, rule) for trial in range(200)]
    assert vectors == [trials.weights(3, trial, rule) for trial in reversed(range(200))][::-1]
    array = np.array(vectors)
    assert np.all(array >= 0) and np.allclose(array.sum(axis=1), 1)
    assert len(set(vectors)) == 200
    assert vectors[0] != trials.weights(4, 0, rule)
    assert np.allclose(array.mean(axis=0), 0.25, atol=0.04)


def test_the_rules_differ_in_spread():
    dirichlet = np.array([trials.weights(0, trial, "dirichlet") for trial in range(2000)])
    release = np.array([trials.weights(0, trial, "release") for trial in range(2000)])
    assert dirichlet.std(axis=0) == pytest.approx(np.full(4, np.sqrt(3 / 80)), abs=0.01)  # Dirichlet(1, 1, 1, 1)
    assert np.all(release.std(axis=0) < 0.16)


def test_unknown_rule_is_refused_and_nothing_written(tmp_path):
    with pytest.raises(StoreError, match="choose one of: dirichlet, release, sobol, tpe, cmaes, nsga2"):
        make(tmp_path / "s", rule="sobolev")
    assert list((tmp_path / "s").iterdir()) == []


def test_a_study_that_a_crash_left_half_made_is_never_seen(tmp_path, monkeypatch):
    import optuna

    def crash(self, key, value):
        raise KeyboardInterrupt

    monkeypatch.setattr(optuna.Study, "set_user_attr", crash)
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path)
    assert not (tmp_path / "study.db").exists()
    monkeypatch.undo()
    assert make(tmp_path).missing(1) == 1


def test_total_semantics(tmp_path):
    study = make(tmp_path)
    seen = []
    for ticket in tickets(study, 3):
        seen.append(ticket)
        study.finish(ticket, outcome())
    assert [ticket.trial for ticket in seen] == [0, 1, 2]
    assert [ticket.weights for ticket in seen] == [trials.weights(5, k, "dirichlet") for k in range(3)]
    again = Study.open(tmp_path)
    assert again.missing(3) == 0 and list(tickets(again, 3)) == []
    assert again.missing(5) == 2
    for ticket in tickets(again, 5):
        again.finish(ticket, outcome())
    assert again.counts() == {"done": 5, "failed": 0, "pruned": 0, "running": 0}


def test_a_trial_left_running_is_handed_out_again_first(tmp_path):
    study = make(tmp_path)
    first = study.claim(2)  # its process dies here
    again = Study.open(tmp_path)
    assert again.claim(1) is None  # as far as anybody knows it is being worked on
    assert again.take_over() == 1
    handed = again.claim(2)
    assert (handed.trial, handed.weights, handed.lease.losses) == (first.trial, first.weights, 1)
    again.finish(handed, outcome())
    assert again.claim(2).trial == 1


def test_failed_trials_keep_their_reason_and_count_as_finished(tmp_path):
    study = make(tmp_path)
    ticket = next(tickets(study, 2))
    study.fail(ticket, "loss is not finite at step 12", steps=12)
    assert study.missing(2) == 1
    row = trials.read_table(tmp_path).iloc[0]
    assert row["state"] == "failed" and row["error"] == "loss is not finite at step 12" and row["steps"] == 12
    with pytest.raises(StoreError, match="no trial of the study is done yet"):
        trials.best(trials.read_table(tmp_path))


def test_table_and_choice(tmp_path):
    study = make(tmp_path)
    for ticket, sr, cfr in zip(tickets(study, 3), (0.4, 0.8, 0.8), (0.9, 0.5, 0.7), strict=True):
        study.report(ticket, 500, sr / 2)
        study.finish(ticket, outcome(sr, cfr=cfr, policy=f"trials/{ticket.trial}/policy.pt"))
    table = trials.read_table(tmp_path)
    assert list(table.columns) == list(trials.COLUMNS)
    assert list(table["state"]) == ["done"] * 3
    assert trials.select(table, "best")["trial"] == 2
    assert trials.row_weights(trials.select(table, "trial=0")) == trials.weights(5, 0, "dirichlet")
    with pytest.raises(StoreError, match="has no trial 17"):
        trials.select(table, "trial=17")
    with pytest.raises(StoreError, match="neither best nor"):
        trials.select(table, "third")


def test_other_settings_are_refused(tmp_path):
    study = make(tmp_path)
    study.refuse_other(SETTINGS, seed=5, rule="dirichlet")
    other = SETTINGS | {"reward": {"name": "release"}}
    with pytest.raises(StoreError, match=r"reward\.name was shaped, is now release"):
        study.refuse_other(other, seed=5, rule="dirichlet")
    with pytest.raises(StoreError, match="seed was 5, is now 6"):
        study.refuse_other(SETTINGS, seed=6, rule="dirichlet")


def test_a_setting_that_came_later_counts_as_what_was_done_before(tmp_path):
    before = {"drone": {"name": "crazyflie"}, "reward": {"name": "shaped"}}
    study = Study.create(tmp_path, seed=5, rule="dirichlet", settings=before)
    study.refuse_other(before | {"drone": {"name": "crazyflie", "latency": 0.0}}, seed=5, rule="dirichlet")
    with pytest.raises(StoreError, match=r"drone\.latency was 0\.0, is now 0\.02"):
        study.refuse_other(before | {"drone": {"name": "crazyflie", "latency": 0.02}}, seed=5, rule="dirichlet")
    with pytest.raises(StoreError, match=r"drone\.new was \(absent\), is now 1"):
        study.refuse_other(before | {"drone": {"name": "crazyflie", "new": 1}}, seed=5, rule="dirichlet")


def test_a_rate_that_is_none_is_refused(tmp_path):
    study = make(tmp_path)
    ticket = next(tickets(study, 1))
    with pytest.raises(StoreError, match="not a rate"):
        study.finish(ticket, outcome(float("nan")))


def test_missing_damaged_and_foreign_databases_are_one_line(tmp_path):
    with pytest.raises(StoreError, match="does not exist"):
        Study.open(tmp_path)
    (tmp_path / "study.db").write_bytes(b"this is not a database at all" * 100)
    with pytest.raises(StoreError, match="cannot be used: file is not a database"):
        Study.open(tmp_path)
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    sqlite3.connect(foreign / "study.db").close()
    (foreign / "study.db").touch()
    with pytest.raises(StoreError, match="is not a study of formctl"):
        Study.open(foreign)


def test_no_table_is_one_line(tmp_path):
    with pytest.raises(StoreError, match="cannot be read"):
        trials.read_table(tmp_path)
