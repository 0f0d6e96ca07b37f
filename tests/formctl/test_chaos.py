"""A search whose workers are shot; ``tests/stress/chaos.py`` is the same for an hour."""

import os
import signal
import threading
import time
from contextlib import suppress

import pytest

from formctl import trials
from tests.stress.chaos import workers


@pytest.fixture
def killer():
    """Kill the first two worker processes that appear, as soon as they do."""
    killed, done = [], threading.Event()

    def hunt():
        while len(killed) < 2 and not done.wait(0.02):
            for pid in workers(os.getpid(), "local"):
                if pid not in killed and len(killed) < 2:
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                        killed.append(pid)

    thread = threading.Thread(target=hunt)
    yield thread.start, killed
    done.set()
    thread.join()


def test_killed_workers_lose_nothing_and_double_nothing(formctl, only, killer):
    start, killed = killer
    start()
    answer = formctl("search", "engine.jobs=2", "train.checkpoint_minutes=1e-9", "--trials", "3")
    assert answer.code == 0, answer.err
    assert len(killed) == 2 and answer.err.count("another one goes on with it") == 2
    assert "workers lost in the middle of a trial, over the whole study: 2" in answer.out
    table = trials.read_table(only("search").path)
    assert list(table["trial"]) == [0, 1, 2] and list(table["state"]) == ["done"] * 3
    assert [trials.row_weights(row) for _, row in table.iterrows()] == [
        trials.weights(0, number, "dirichlet") for number in range(3)
    ]


def test_an_owner_that_is_killed_takes_its_workers_along(tmp_path):
    """And not before: workers that outlive their owner would work on what somebody else hands out again."""
    from tests.formctl.test_processes import work

    reader, writer = os.pipe()
    owner = os.fork()
    if owner == 0:
        from formctl.processes import Processes

        def tell(request, note):
            os.write(writer, f"{note['pid']}\n".encode())

        left = iter(["hang"])
        list(Processes(1, 60.0).run(work, lambda: next(left, None), tell))
        os._exit(1)
    worker = int(os.read(reader, 20))
    os.kill(owner, signal.SIGKILL)
    os.waitpid(owner, 0)
    deadline = time.monotonic() + 20
    while os.path.exists(f"/proc/{worker}") and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not os.path.exists(f"/proc/{worker}")
