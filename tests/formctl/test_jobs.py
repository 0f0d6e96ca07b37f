"""Episodes side by side in worker processes: the same rows, and nothing flown is lost."""

import os
from dataclasses import replace

import pandas as pd
import pytest
import torch

from envs.bank import Bank
from formctl import store
from formctl.engines import workers
from formctl.errors import RunFailed
from formctl.evaluation import evaluate, flight, methods, scenes
from formctl.evaluation.journal import EpisodeJournal, groups
from formctl.evaluation.rows import failure_reasons, write_rows
from formctl.settings import build, compose
from formctl.store.files import plain
from tests.baselines import example
from tests.formctl import chores


def planner(make=example.make):
    facts = {"name": "planner", "kind": "baseline", "seed": 0, "run": ""}
    return methods.Method(facts, "", (), make, {"deviations": ["avoids nothing"]})


def troubled(env):
    return example.make(env, trouble="raise")


def test_results_come_with_their_numbers_from_processes_of_one_thread():
    assert sorted(workers.share(chores.double, range(5), jobs=2)) == [(k, 2 * k) for k in range(5)]
    ((_, (process, threads)),) = workers.share(chores.surroundings, [0], jobs=4)
    assert process != os.getpid() and threads == "1"
    assert list(workers.share(chores.double, [], jobs=2)) == []


def test_an_exception_is_raised_where_it_was_asked_for():
    with pytest.raises(ValueError, match="two cannot be done"):
        list(workers.share(chores.stumble, range(4), jobs=1))


def test_a_killed_worker_is_noticed():
    got = []
    with pytest.raises(workers.WorkerLost, match=r"process \d+ died: killed, or out of memory"):
        got += (index for index, _ in workers.share(chores.vanish, range(4), jobs=1))


def test_rows_do_not_depend_on_processes_or_interruptions(tmp_path):
    """Two at a time, then alone with two of three episodes in the journal and its last line torn."""
    config = compose(["scenario=mixed", "eval.seconds=1.1", "profile=smoke"])
    scene = scenes.EvaluationScene(build.world(config), Bank.create(config.scenario, 3, seed=3))
    journal, heard = tmp_path / "flown.jsonl", []
    rows = evaluate.evaluate(planner(troubled), [scene], config, heard.append, jobs=2, journal=journal)
    assert heard in ([0, 1, 3], [0, 2, 3]) and list(rows["scenario_id"]) == [0, 1, 2]
    assert list(rows["planner_failures"]) == [5] * 3
    assert set(rows["planner_reason"]) == {"ArithmeticError: the solver gave up"}
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[:2]) + lines[2][:40])
    heard.clear()
    again = evaluate.evaluate(planner(troubled), [scene], config, heard.append, jobs=1, journal=journal)
    assert heard == [2, 3]
    for name, table in (("rows", rows), ("again", again)):
        write_rows(tmp_path / name, table)
    assert (tmp_path / "rows").read_bytes() == (tmp_path / "again").read_bytes()
    hover = evaluate.evaluate(methods.baseline("hover"), [scene], config)
    assert list(hover.columns) == list(rows.columns) and (hover.dtypes == rows.dtypes).all()


@pytest.fixture
def in_this_process(monkeypatch):
    """Flights without processes; ``stop`` is raised after as many episodes, once."""
    plan = {"after": 99, "stop": None, "flown": 0}

    def share(function, requests, jobs):
        for index, request in enumerate(requests):
            if plan["stop"] is not None and index == plan["after"]:
                stop, plan["stop"] = plan["stop"], None
                raise stop
            plan["flown"] += 1
            yield index, function(request)

    monkeypatch.setattr(workers, "share", share)
    monkeypatch.setattr(flight, "GROUP", 1)
    monkeypatch.setattr(methods, "baseline", lambda name, own=(): planner())
    return plan


@pytest.mark.parametrize(
    ("stop", "code", "status"),
    [(KeyboardInterrupt(), 130, "interrupted"), (workers.WorkerLost("process 7 was killed"), 1, "failed")],
)
def test_an_interrupted_evaluation_goes_on(formctl, only, in_this_process, tmp_path, stop, code, status):
    in_this_process.update(after=2, stop=stop)
    answer = formctl("eval", "--baseline", "planner")
    assert answer.code == code and "the same command again goes on" in answer.line
    assert only("eval").status == status
    answer = formctl("eval", "--baseline", "planner", "--out", str(tmp_path / "rows.parquet"))
    assert answer.code == 0 and "2 episodes were flown before the interruption" in answer.out, answer.err
    run = only("eval")
    assert run.status == "done" and in_this_process["flown"] == 3
    assert not (run.path / "flown.jsonl").exists()
    assert run.record["method"]["name"] == "planner"
    assert "failed by" in answer.out and "late" in answer.out
    assert list(pd.read_parquet(tmp_path / "rows.parquet")["scenario_id"]) == [0, 1, 2]


def test_methods_that_were_finished_before_an_interruption_are_not_flown_again(
    formctl, in_this_process, tmp_path, monkeypatch
):
    named = {name: replace(planner(), facts=planner().facts | {"name": name}) for name in ("planner", "other")}
    monkeypatch.setattr(methods, "baseline", lambda name, own=(): named[name])
    both = ("eval", "--baseline", "planner", "--baseline", "other")
    in_this_process.update(after=1, stop=None)
    assert formctl(*both).code == 0 and in_this_process["flown"] == 6
    in_this_process.update(after=99, stop=KeyboardInterrupt(), flown=0)
    share = workers.share

    def second(function, requests, jobs):
        if in_this_process["flown"] == 3:
            in_this_process.update(after=1)
        return share(function, requests, jobs)

    monkeypatch.setattr(workers, "share", second)
    assert formctl(*both).code == 130 and in_this_process["flown"] == 4
    answer = formctl(*both)
    assert answer.code == 0 and "planner: flown before the interruption, in " in answer.out, answer.err
    assert in_this_process["flown"] == 6
    assert formctl(*both).code == 0 and in_this_process["flown"] == 12
    assert [run.status for run in store.scan(tmp_path, kind="eval")] == ["done"] * 6


def test_other_settings_start_afresh(formctl, in_this_process, tmp_path):
    in_this_process.update(after=1, stop=KeyboardInterrupt())
    formctl("eval", "--baseline", "planner")
    assert formctl("eval", "--baseline", "planner", "eval.corridor=2.4").code == 0
    assert len(store.scan(tmp_path, kind="eval")) == 2 and in_this_process["flown"] == 4


def test_a_journal_of_more_episodes_than_asked_for_is_not_trusted_blindly(tmp_path):
    config = compose(["scenario=mixed", "eval.seconds=1.1", "profile=smoke"])
    scene = scenes.EvaluationScene(build.world(config), Bank.create(config.scenario, 1, seed=3))
    journal = EpisodeJournal(tmp_path / "flown.jsonl")
    for number in (0, 7):
        journal.add(number, {"fm": float(number)})
    assert sorted(journal.read()) == [0, 7]
    table = evaluate.evaluate(planner(), [scene], config, journal=journal.path)
    assert list(table["fm"]) == [0.0]


def test_reasons_count_failures_and_name_an_episode():
    failure = ["", "late", "column", "late", ""]
    rows = pd.DataFrame({"failure": failure, "scenario_id": range(10, 15), "planner_failures": [3, 2, 0, 1, 0]})
    rows["planner_reason"] = ["no path", "no path", "", "stuck", ""]
    assert failure_reasons(rows) == [("column", 1, 2), ("late", 2, 1), ("of these, planner (no path)", 2, 1)]
    assert failure_reasons(rows[["failure", "scenario_id"]]) == [("column", 1, 2), ("late", 2, 1)]


def test_a_lost_worker_says_what_is_kept(monkeypatch):
    def share(function, requests, jobs):
        yield 0, {"fm": [1.0]}
        raise workers.WorkerLost("process 7 was killed by SIGKILL")

    config = compose(["scenario=mixed", "profile=smoke"])
    scene = scenes.EvaluationScene(build.world(config), Bank.create(config.scenario, 2, seed=3))
    monkeypatch.setattr(workers, "share", share)
    monkeypatch.setattr(flight, "GROUP", 1)
    with pytest.raises(RunFailed, match="SIGKILL; no episode was kept"):
        evaluate.evaluate(planner(), [scene], config)


def test_planners_fly_the_same_episodes_alone_and_side_by_side():
    """To the last bit: rows may not depend on who else was in the air, on processes or on interruptions."""
    config = compose(["scenario=mixed", "scenario.throw_time=[0.2,0.4]", "eval.seconds=1.6", "profile=smoke"])
    scene = scenes.EvaluationScene(build.world(config), Bank.create(config.scenario, 3, seed=3))
    worker = flight.EpisodeWorker.of(methods.baseline("swarm_formation_fair"), scene.world, config)
    episodes = list(scenes.batches(scene.bank.scenarios, 1))
    together = plain(flight.rows_of(worker.fly(scenes.concatenate(episodes))))
    assert together == [plain(row) for episode in episodes for row in flight.rows_of(worker.fly(episode))]
    assert len({row["fm"] for row in together}) == 3


def test_groups_are_of_one_shape_and_of_no_more_than_asked_for():
    sizes = [1, 1, 1, 2, 2, 1]
    episodes = [(torch.zeros(1, size),) for size in sizes]
    assert list(groups(episodes, [0, 1, 2, 3, 5], 2)) == [[0, 1], [2], [3], [5]]
