"""A search whose workers are shot; ``tests/stress/chaos.py`` is the same on a larger scale."""

import os
import signal
import threading
from contextlib import suppress

import pytest

from formctl.search import laws, table
from formctl.store.files import read_json


@pytest.fixture
def killer(tmp_path):
    """Kill the first two processes that are seen at work on a trial."""
    killed, done = [], threading.Event()

    def hunt():
        while len(killed) < 2 and not done.wait(0.01):
            for path in tmp_path.glob("search/*/*/trials/*/run.json"):
                record = read_json(path)
                pid = record.get("process", {}).get("pid")
                if record["status"] == "running" and pid not in killed and len(killed) < 2:
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                        killed.append(pid)

    thread = threading.Thread(target=hunt)
    yield thread.start, killed
    done.set()
    thread.join()


@pytest.mark.timeout(900)  # on a machine that has other things to do
def test_killed_workers_lose_nothing_and_double_nothing(formctl, only, killer):
    start, killed = killer
    start()
    answer = formctl("search", "engine.jobs=2", "train.checkpoint_minutes=1e-9", "--trials", "3")
    assert answer.code == 0, answer.err
    assert len(killed) == 2 and answer.err.count("another one goes on with it") == 2
    assert "workers lost in the middle of a trial, over the whole study: 2" in answer.out
    rows = table.read_rows(only("search").path)
    assert [(row["trial"], row["state"]) for row in rows] == [(number, "done") for number in range(3)]
    assert [table.weights(row) for row in rows] == [laws.weights(0, number, "dirichlet") for number in range(3)]
