"""The search's record, on SQLite and on PostgreSQL: nothing handed out or recorded twice, and all of it resumable."""

import sqlite3
import threading
import time
from contextlib import closing

import numpy as np
import optuna
import pytest

from formctl.search import database, laws, study, table
from formctl.search.leases import TRIALS, LeaseLost
from formctl.search.study import WeightStudy
from formctl.store.files import StoreError
from tests import postgres

OUTCOME = {"sr": 0.5, "sr_k": 5, "sr_n": 10, "cfr": 0.6, "fm": None, "steps": 1000, "minutes": 0.1, "policy": "p.pt"}
SETTINGS = {"drone": {"name": "crazyflie"}, "reward": {"name": "shaped"}}


@pytest.fixture(scope="module")
def server():
    if reason := postgres.missing():
        pytest.skip(reason)
    with postgres.server() as address:
        yield address


@pytest.fixture(params=["sqlite", "postgres"])
def make(request, tmp_path):
    """Make a study, or open the one that was made."""
    url = database.read(request.getfixturevalue("server")) if request.param == "postgres" else None
    name = request.node.name if url else table.NAME

    def made(rule="dirichlet", lease=600.0, open_=False, settings=SETTINGS):
        if open_:
            found = WeightStudy(tmp_path, url or database.sqlite(tmp_path / "study.db"), name)
        else:
            found = WeightStudy.create(tmp_path, seed=5, rule=rule, settings=settings, url=url, name=name, trials=9)
        found.lease = lease
        return found

    return made


@pytest.fixture
def ours(tmp_path):
    """A study on SQLite."""
    return WeightStudy.create(tmp_path, seed=5, rule="dirichlet", settings=SETTINGS, trials=9)


def again(folder):
    """The study on SQLite as another process sees it."""
    return WeightStudy(folder, database.sqlite(folder / "study.db"))


@pytest.mark.parametrize("law", sorted(laws.LAWS))
def test_weights_are_a_pure_function_on_the_simplex(law):
    vectors = [laws.weights(3, trial, law) for trial in range(200)]
    assert vectors == [laws.weights(3, trial, law) for trial in reversed(range(200))][::-1]
    array = np.array(vectors)
    assert np.all(array >= 0) and np.allclose(array.sum(axis=1), 1)
    assert len(set(vectors)) == 200 and vectors[0] != laws.weights(4, 0, law)
    assert np.allclose(array.mean(axis=0), 0.25, atol=0.04)


def test_the_laws_differ_in_spread():
    dirichlet = np.array([laws.weights(0, trial, "dirichlet") for trial in range(2000)])
    release = np.array([laws.weights(0, trial, "release") for trial in range(2000)])
    assert dirichlet.std(axis=0) == pytest.approx(np.full(4, np.sqrt(3 / 80)), abs=0.01)  # Dirichlet(1, 1, 1, 1)
    assert np.all(release.std(axis=0) < 0.16)


def test_a_trial_goes_from_claim_to_complete_and_optuna_reads_it(make):
    ours = make()
    ticket = ours.claim(2)
    ours.report(ticket, 100, 0.25)
    ours.report(ticket, 200, 0.5)
    ours.report(ticket, 300, float("nan"))  # a sign of life all the same
    ours.finish(ticket, OUTCOME)
    ours.fail(ours.claim(2), "loss is not finite", seed=5)
    assert ours.claim(2) is None and ours.missing(2) == 0
    seen = ours.in_optuna().trials
    assert [trial.state.name for trial in seen] == ["COMPLETE", "FAIL"]
    assert seen[0].value == 0.5 and seen[0].intermediate_values == {100: 0.25, 200: 0.5}
    assert seen[0].user_attrs == OUTCOME | {"trial": 0} and seen[1].user_attrs["error"] == "loss is not finite"
    assert tuple(seen[0].params.values()) == laws.weights(5, 0, "dirichlet")
    assert (seen[0].datetime_complete - seen[0].datetime_start).total_seconds() == pytest.approx(6, abs=0.1)


def test_a_lease_that_ran_out_is_reclaimed_and_its_former_owner_refused(make):
    ours = make(lease=2.0)
    former = ours.claim(1)
    ours.report(former, 50, 0.1)
    assert ours.claim(1) is None  # alive so far
    time.sleep(2.1)
    theirs = make(lease=2.0, open_=True)
    now = theirs.claim(1)
    assert (now.trial, now.weights, now.losses, now.curve) == (former.trial, former.weights, 1, {50: 0.1})
    for event in (
        lambda: ours.report(former, 100, 0.5),
        lambda: ours.finish(former, OUTCOME),
        lambda: ours.fail(former, "no"),
        lambda: ours.give_back(former),
    ):
        with pytest.raises(LeaseLost, match="trial 0 was handed to another worker"):
            event()
    theirs.finish(now, OUTCOME | {"sr": 0.75})
    (trial,) = theirs.in_optuna().trials
    assert trial.value == 0.75 and theirs.leases.losses() == 1


def test_what_is_given_back_or_left_behind_is_handed_out_first(make):
    ours = make()
    first, second = ours.claim(3), ours.claim(3)
    ours.give_back(second)
    theirs = make(open_=True)
    assert theirs.claim(3).trial == second.trial
    assert theirs.leases.end_all() == 2
    handed = theirs.claim(3)
    assert (handed.trial, handed.weights, handed.losses) == (first.trial, first.weights, 1)


def test_a_worker_that_dies_between_recording_and_saying_so_records_once(make, monkeypatch):
    ours = make()
    ticket = ours.claim(2)
    monkeypatch.setattr(ours.leases, "end", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        ours.finish(ticket, OUTCOME)
    theirs = make(open_=True)
    theirs.leases.end_all()
    assert theirs.claim(2).trial == 1  # trial 0 is found on record
    assert len(theirs.in_optuna().trials) == 1 and theirs.counts()["done"] == 1
    assert theirs.rows()[0]["sr"] == 0.5


def test_a_worker_that_dies_before_recording_leaves_room_for_others(make, monkeypatch):
    """The place that was noted for its trial goes to the next one that is finished."""
    ours = make()
    first, second = ours.claim(2), ours.claim(2)
    monkeypatch.setattr(ours, "_add", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        ours.finish(first, OUTCOME)
    theirs = make(open_=True)
    theirs.finish(second, OUTCOME | {"sr": 0.25})
    theirs.leases.end_all()
    theirs.finish(theirs.claim(2), OUTCOME)
    assert [(row["trial"], row["number"], row["sr"]) for row in theirs.rows()] == [(0, 1, 0.5), (1, 0, 0.25)]


def test_failed_trials_are_retried_with_their_weights(make):
    ours = make()
    ours.fail(ours.claim(2), "disk full")
    ours.finish(ours.claim(2), OUTCOME)
    assert ours.leases.reopen(2) == 1
    retried = ours.claim(2)
    assert retried.trial == 0 and retried.weights == laws.weights(5, 0, "dirichlet")
    ours.finish(retried, OUTCOME)
    assert ours.counts() == {"done": 2, "failed": 0, "pruned": 0, "running": 0}
    assert [(row["number"], row["error"]) for row in ours.rows()] == [(2, None), (1, None)]
    assert ours.claim(3).weights == laws.weights(5, 2, "dirichlet")  # Optuna's next number is 3


@pytest.mark.parametrize(("rule", "count"), [("tpe", 12), ("cmaes", 4), ("nsga2", 4)])
def test_optunas_samplers_neither_repeat_each_other_nor_themselves(tmp_path, rule, count):
    ours = WeightStudy.create(tmp_path, seed=5, rule=rule, settings={})
    first = ours.claim(count)
    assert again(tmp_path).leases.end_all() == 1
    handed = ours.claim(count)
    assert handed.weights == first.weights  # what was proposed stays
    vectors = [handed.weights]
    ours.finish(handed, OUTCOME)
    while (ticket := ours.claim(count)) is not None:
        vectors.append(ticket.weights)
        ours.finish(ticket, OUTCOME | {"sr": ticket.weights[0]})
    assert len(set(vectors)) == count and all(sum(vector) == pytest.approx(1) for vector in vectors)
    assert [table.weights(row) for row in ours.rows()] == vectors
    assert {trial.state.name for trial in ours.in_optuna().trials} == {"COMPLETE"}


def test_many_claims_at_once_give_every_trial_once(server, tmp_path):
    url = database.read(server)
    WeightStudy.create(tmp_path, seed=5, rule="dirichlet", settings={}, url=url, name="crowd")
    found = []

    def claim():
        own = WeightStudy(tmp_path, url, "crowd")
        while (ticket := own.claim(12)) is not None:
            found.append((ticket.trial, ticket.weights))
            own.finish(ticket, OUTCOME)

    threads = [threading.Thread(target=claim) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(found) == [(k, laws.weights(5, k, "dirichlet")) for k in range(12)]
    kept = WeightStudy(tmp_path, url, "crowd").in_optuna().trials
    assert sorted(trial.user_attrs["trial"] for trial in kept) == list(range(12))


def test_a_pruner_sees_the_curves_of_finished_trials(ours):
    pruner = optuna.pruners.MedianPruner(n_startup_trials=2, n_warmup_steps=0)
    for _ in range(3):
        good = ours.claim(5)
        ours.report(good, 10, 0.9)
        ours.finish(good, OUTCOME)
    bad = ours.claim(5)
    assert ours.prune_reason(bad, pruner) is None  # nothing is known of it yet
    ours.report(bad, 10, 0.1)
    assert ours.prune_reason(bad, pruner) == "MedianPruner, after 10 steps"
    ours.prune(bad, "late")
    assert ours.counts()["pruned"] == 1


def test_the_table_is_made_anew_wherever_it_is_not_what_the_database_says(ours, tmp_path):
    for sr in (0.25, 0.75):
        ours.finish(ours.claim(3), OUTCOME | {"sr": sr})
    ours.write_table()
    path = tmp_path / "trials.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert [row["sr"] for row in table.read_rows(tmp_path)] == [0.25, 0.75]
    path.unlink()
    assert [row["sr"] for row in table.read_rows(tmp_path)] == [0.25, 0.75]
    path.write_bytes(whole)
    ours.finish(ours.claim(3), OUTCOME | {"sr": 0.5})
    path.write_bytes(whole)  # as it was before
    ours.note_trial(1, sr_fresh=0.7)
    found = table.read_rows(tmp_path)
    assert [row["sr"] for row in found] == [0.25, 0.75, 0.5] and found[1]["sr_fresh"] == 0.7
    (tmp_path / "study.db").unlink()  # as on a host that has only the file
    assert [row["sr"] for row in table.read_rows(tmp_path)] == [0.25, 0.75]
    assert list(table.read_table(tmp_path).columns) == list(table.COLUMNS)


def test_no_study_is_one_line(tmp_path):
    with pytest.raises(StoreError, match="has no study"):
        table.read_rows(tmp_path)


def test_other_settings_are_refused_and_later_ones_count_as_before(ours):
    ours.refuse_other(SETTINGS, seed=5, rule="dirichlet")
    drone = SETTINGS["drone"]
    ours.refuse_other(SETTINGS | {"drone": drone | {"latency": 0.0}}, seed=5, rule="dirichlet")
    for settings, seed, message in (
        (SETTINGS | {"reward": {"name": "release"}}, 5, r"reward\.name was shaped, is now release"),
        (SETTINGS, 6, "seed was 5, is now 6"),
        (SETTINGS | {"drone": drone | {"latency": 0.02}}, 5, r"drone\.latency was 0\.0, is now 0\.02"),
    ):
        with pytest.raises(StoreError, match=message):
            ours.refuse_other(settings, seed=seed, rule="dirichlet")


def test_a_rate_that_is_none_is_refused(ours):
    with pytest.raises(StoreError, match="not a rate"):
        ours.finish(ours.claim(1), OUTCOME | {"sr": float("nan")})


def test_an_unknown_rule_is_refused_and_nothing_written(tmp_path):
    with pytest.raises(StoreError, match="choose one of: dirichlet, release, sobol, tpe, cmaes, nsga2"):
        WeightStudy.create(tmp_path, seed=5, rule="sobolev", settings={})
    assert list(tmp_path.iterdir()) == []


def test_a_study_that_a_crash_left_half_made_is_finished(tmp_path, monkeypatch):
    def crash(self, key, value):
        raise KeyboardInterrupt

    monkeypatch.setattr(optuna.Study, "set_user_attr", crash)
    with pytest.raises(KeyboardInterrupt):
        WeightStudy.create(tmp_path, seed=5, rule="dirichlet", settings={})
    with pytest.raises(StoreError, match="is not a study of formctl"):
        again(tmp_path)
    monkeypatch.undo()
    assert WeightStudy.create(tmp_path, seed=5, rule="dirichlet", settings={}).missing(1) == 1


def test_damaged_and_foreign_databases_are_one_line_and_left_as_they_are(tmp_path):
    path = tmp_path / "study.db"
    path.write_bytes(b"this is not a database at all" * 100)
    with pytest.raises(StoreError, match="cannot be used: file is not a database"):
        again(tmp_path)
    path.unlink()
    sqlite3.connect(path).close()
    with pytest.raises(StoreError, match="is not a study of formctl"):
        again(tmp_path)
    path.unlink()
    optuna.create_study(storage=f"sqlite:///{path}", study_name="theirs")
    before = path.read_bytes()
    with pytest.raises(StoreError, match="has no study weights: there is theirs"):
        again(tmp_path)
    assert path.read_bytes() == before


def test_a_full_database_is_one_line_and_goes_on_when_there_is_room(ours):
    ticket = ours.claim(2)
    with ours.leases._engine.connect() as connection:
        pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
    engine = ours._storage.engine
    with engine.connect() as connection:  # the pool of one file keeps its connection
        connection.exec_driver_sql(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(StoreError, match=r"study\.db cannot be used: database or disk is full"):
            fill(connection, ours)
    assert ours.counts()["running"] == 1 and ours.in_optuna().trials == []  # no half event
    ours.finish(ticket, OUTCOME | {"note": "x" * 100_000})
    assert ours.counts()["done"] == 1


def fill(connection, ours):
    """Write more than there is room for, as a trial would."""
    text = "x" * 1_000_000
    statement = TRIALS.insert().values(study="other", trial=0, state=text, seen=0.0, losses=0)
    database.attempt(ours.url, lambda: connection.execute(statement))


def test_a_file_that_somebody_reads_is_no_hindrance(ours, tmp_path):
    with database.written_ahead(ours.url), closing(ours), closing(sqlite3.connect(tmp_path / "study.db")) as reader:
        reader.execute("BEGIN")
        reader.execute("SELECT count(*) FROM trials").fetchone()
        ours.finish(ours.claim(1), OUTCOME)
        assert reader.execute("SELECT count(*) FROM trials").fetchone() == (0,)
    assert not list(tmp_path.glob("study.db-*")) and ours.counts()["done"] == 1


def test_a_file_that_somebody_locks_is_waited_for(ours, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(database, "BUSY", 0.1)
    ours.close()
    theirs = again(tmp_path)
    locker = sqlite3.connect(tmp_path / "study.db", check_same_thread=False)
    locker.execute("BEGIN EXCLUSIVE")
    timer = threading.Timer(1.0, locker.rollback)
    timer.start()
    assert theirs.claim(1).trial == 0
    timer.join()
    locker.close()
    assert "is locked by another program; waiting for it to let go" in capsys.readouterr().err


def test_passwords_are_never_shown(server):
    wrong = server.replace(postgres.PASSWORD, "wrong-horse")
    with pytest.raises(StoreError, match=r"cannot be used.*password authentication failed") as refused:
        study.known(database.read(wrong))
    assert "wrong-horse" not in str(refused.value) and "\n" not in str(refused.value)
    for address in (server, "postgresql://u@h/d?password=wrong-horse", "postgres://u:p%40wrong-horse@h/d"):
        shown = database.shown(database.read(address))
        assert postgres.PASSWORD not in shown and "wrong-horse" not in shown and shown.startswith("postgresql://")


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("mysql://u:secret@h/d", "--storage mysql:// is not supported"),
        ("nonsense", "--storage is no address"),
        ("postgresql://u:secret@127.0.0.1:1/d", "connection refused|Connection refused"),
    ],
)
def test_addresses_that_lead_nowhere_are_one_line(address, message):
    with pytest.raises(StoreError, match=message) as refused:
        study.known(database.read(address))
    assert "secret" not in str(refused.value) and "\n" not in str(refused.value)
