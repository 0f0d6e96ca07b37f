"""Leases and events, the same on SQLite and on PostgreSQL: nothing handed out twice, late-comers told no."""

import threading
import time

import optuna
import pytest

from formctl.search import overview, storage, study, trials
from formctl.search.ledger import LeaseLost
from formctl.search.study import Study
from formctl.store.files import StoreError
from tests import postgres

OUTCOME = {"sr": 0.5, "sr_k": 5, "sr_n": 10, "cfr": 0.6, "fm": None, "steps": 1000, "minutes": 0.1, "policy": "p.pt"}


@pytest.fixture(scope="module")
def server():
    if reason := postgres.missing():
        pytest.skip(reason)
    with postgres.server() as address:
        yield address


@pytest.fixture(params=["sqlite", "postgres"])
def make(request, tmp_path):
    """Make a study, or open the one that was made."""
    name = request.node.name
    url = storage.read(request.getfixturevalue("server")) if request.param == "postgres" else None

    def made(rule="dirichlet", lease=600.0, open_=False):
        if open_:
            found = Study.open(tmp_path, url, name if url else None)
        else:
            found = Study.create(tmp_path, seed=5, rule=rule, settings={"a": 1}, url=url, name=name)
        found.lease = lease
        return found

    return made


def test_a_trial_goes_from_claim_to_complete_and_optuna_reads_it(make):
    ours = make()
    ticket = ours.claim(2)
    ours.report(ticket, 100, 0.25)
    ours.report(ticket, 200, 0.5)
    ours.finish(ticket, OUTCOME)
    ours.fail(ours.claim(2), "loss is not finite", seed=5)
    assert ours.claim(2) is None and ours.missing(2) == 0
    seen = ours.optuna().trials
    assert [trial.state.name for trial in seen] == ["COMPLETE", "FAIL"]
    assert seen[0].value == 0.5 and seen[0].intermediate_values == {100: 0.25, 200: 0.5}
    assert seen[0].user_attrs == OUTCOME and seen[1].user_attrs["error"] == "loss is not finite"
    assert tuple(seen[0].params.values()) == trials.weights(5, 0, "dirichlet")
    assert seen[0].datetime_complete >= seen[0].datetime_start
    assert overview.top(ours.ledger, 5)[0]["trial"] == 0


def test_a_lease_that_ran_out_is_reclaimed_and_its_former_owner_told_no(make):
    ours = make(lease=0.2)
    former = ours.claim(1)
    assert ours.claim(1) is None  # alive so far
    time.sleep(0.3)
    theirs = make(lease=0.2, open_=True)
    now = theirs.claim(1)
    assert (now.trial, now.weights, now.lease.losses) == (former.trial, former.weights, 1)
    for event in (
        lambda: ours.report(former, 100, 0.5),
        lambda: ours.finish(former, OUTCOME),
        lambda: ours.fail(former, "no"),
        lambda: ours.give_back(former),
    ):
        with pytest.raises(LeaseLost, match="trial 0 was handed to another worker"):
            event()
    theirs.finish(now, OUTCOME | {"sr": 0.75})
    (trial,) = theirs.optuna().trials
    assert trial.value == 0.75 and trial.intermediate_values == {}  # nothing of the former owner's
    assert overview.losses(theirs.ledger) == 1


def test_a_sign_of_life_keeps_a_lease(make):
    ours = make(lease=1.0)
    ticket = ours.claim(1)
    for _ in range(5):
        time.sleep(0.3)
        ours.report(ticket, 1, 0.5)
    assert make(lease=1.0, open_=True).claim(1) is None


def test_failed_trials_are_retried_once_asked(make):
    ours = make()
    ours.fail(ours.claim(2), "disk full")
    ours.finish(ours.claim(2), OUTCOME)
    assert ours.ledger.retry_failed(2) == 1
    again = ours.claim(2)
    assert again.trial == 0 and again.weights == trials.weights(5, 0, "dirichlet")
    ours.finish(again, OUTCOME)
    assert ours.counts() == {"done": 2, "failed": 0, "pruned": 0, "running": 0}
    assert ours.table()["error"].isna().all()


@pytest.mark.parametrize(("rule", "count"), [("tpe", 12), ("cmaes", 4), ("nsga2", 4)])
def test_optunas_samplers_neither_repeat_each_other_nor_themselves(tmp_path, rule, count):
    ours = Study.create(tmp_path, seed=5, rule=rule, settings={})
    first = ours.claim(count)
    assert Study.open(tmp_path).take_over() == 1
    again = ours.claim(count)
    assert again.weights == first.weights  # what was proposed stays
    vectors = [again.weights]
    ours.finish(again, OUTCOME)
    while (ticket := ours.claim(count)) is not None:
        vectors.append(ticket.weights)
        ours.finish(ticket, OUTCOME | {"sr": ticket.weights[0]})
    assert len(set(vectors)) == count and all(sum(vector) == pytest.approx(1) for vector in vectors)
    assert list(ours.table()["w_formation"]) == [vector[0] for vector in vectors]


def test_many_claims_at_once_give_every_trial_once(server, tmp_path):
    url = storage.read(server)
    Study.create(tmp_path, seed=5, rule="dirichlet", settings={}, url=url, name="crowd").ledger.close()
    found = []

    def claim():
        own = Study.open(tmp_path, url, "crowd")
        while (ticket := own.claim(12)) is not None:
            found.append((ticket.trial, ticket.weights))
            own.ledger.settle(ticket.lease, "COMPLETE", 0.5, OUTCOME)
        own.ledger.close()

    threads = [threading.Thread(target=claim) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(found) == [(k, trials.weights(5, k, "dirichlet")) for k in range(12)]


def test_passwords_are_never_shown(server, tmp_path):
    wrong = server.replace(postgres.PASSWORD, "wrong-horse")
    with pytest.raises(StoreError, match=r"cannot be used.*password authentication failed") as refused:
        study.known(storage.read(wrong))
    assert "wrong-horse" not in str(refused.value) and "\n" not in str(refused.value)
    for address in (server, "postgresql://u@h/d?password=wrong-horse", "postgres://u:p%40wrong-horse@h/d"):
        shown = storage.shown(storage.read(address))
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
        study.known(storage.read(address))
    assert "secret" not in str(refused.value) and "\n" not in str(refused.value)


def test_a_full_database_is_one_line_and_goes_on_when_there_is_room(tmp_path):
    ours = Study.create(tmp_path, seed=5, rule="dirichlet", settings={})
    ticket = ours.claim(2)
    with ours.ledger.event() as connection:
        pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
        connection.exec_driver_sql(f"PRAGMA max_page_count = {pages}")
    big = OUTCOME | {"note": "x" * 100_000}
    with pytest.raises(StoreError, match=r"study\.db cannot be used: database or disk is full"):
        ours.finish(ticket, big)
    assert ours.counts()["running"] == 1 and ours.optuna().trials[0].user_attrs == {}  # no half event
    with ours.ledger.event() as connection:
        connection.exec_driver_sql("PRAGMA max_page_count = 1000000")
    ours.finish(ticket, big)
    assert ours.counts()["done"] == 1


def test_a_foreign_database_is_left_as_it_is(tmp_path):
    optuna.create_study(storage=f"sqlite:///{tmp_path / 'study.db'}", study_name="theirs")
    before = (tmp_path / "study.db").read_bytes()
    with pytest.raises(StoreError, match="is not a study of formctl"):
        Study.open(tmp_path)
    assert (tmp_path / "study.db").read_bytes() == before
