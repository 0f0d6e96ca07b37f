"""Worker processes: side by side, mortal, and heard. The functions run in processes of their own."""

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from formctl.engines import workers
from formctl.engines.engine import Withdrawn, WorkerLost
from formctl.engines.workers import Processes


def work(request, emit):
    """What ``request`` says: a number is doubled, a word is a way to end."""
    emit({"pid": os.getpid()})
    if request == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if request == "fail":
        raise ValueError("no such thing")
    if request == "cannot save":
        signal.signal(signal.SIGTERM, no_room)
        emit({"pid": os.getpid()})
    if request in ("hang", "cannot save"):
        time.sleep(60)
    return 2 * request


def no_room(number, frame):
    raise OSError("no space left on device")


def run(requests, jobs=2, silence=60.0, listen=lambda request, note: None):
    left = iter(requests)
    return list(Processes(jobs, silence).run(work, lambda: next(left, None), listen))


def test_two_at_a_time_each_answer_to_its_request_and_the_dead_are_named():
    pids = {}
    found = run([1, 2, "die", 3, "fail", 4], listen=lambda request, note: pids.update({request: note["pid"]}))
    by_request = {item.request: item for item in found}
    assert {request: by_request[request].result for request in (1, 2, 3, 4)} == {1: 2, 2: 4, 3: 6, 4: 8}
    assert isinstance(by_request["die"].error, WorkerLost)
    assert str(by_request["die"].error) == f"process {pids['die']} died: killed, or out of memory"
    assert isinstance(by_request["fail"].error, ValueError) and str(by_request["fail"].error) == "no such thing"
    assert 2 <= len(set(pids.values())) <= 3  # two, and one in the place of the dead one where the other left it work
    assert os.getpid() not in pids.values()


def test_a_dead_worker_is_replaced():
    pids = {}
    run([1, "die", 2], jobs=1, listen=lambda request, note: pids.update({request: note["pid"]}))
    assert pids[1] == pids["die"] != pids[2]


def test_a_silent_worker_is_taken_for_dead():
    (hung,) = run(["hang"], silence=1.0)
    assert isinstance(hung.error, WorkerLost) and "no sign of life for 1 s" in str(hung.error)


def test_a_worker_on_what_nobody_wants_any_more_is_stopped():
    def withdraw(request, note):
        raise Withdrawn("handed to somebody else")

    (unwanted,) = run(["hang"], listen=withdraw)
    assert isinstance(unwanted.error, Withdrawn)


def test_an_interrupt_ends_the_workers():
    pids = []

    def interrupt(request, note):
        pids.append(note["pid"])
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(["hang"], listen=interrupt)
    with pytest.raises(ProcessLookupError):
        for _ in range(100):
            os.kill(pids[0], 0)
            time.sleep(0.05)


@pytest.mark.timeout(120)
def test_a_worker_that_cannot_save_keeps_nobody_waiting(monkeypatch):
    """It answers with what went wrong, and is let go: not waited for until it is killed."""
    monkeypatch.setattr(workers, "FAREWELL", math.inf)
    heard = []

    def interrupt(request, note):
        heard.append(note)
        if len(heard) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(["cannot save"], listen=interrupt)


def test_auto_is_one_worker_for_each_core_that_helps(monkeypatch):
    """Two threads of one core are one, and a container's share of time counts."""
    monkeypatch.setattr(workers.os, "sched_getaffinity", lambda _: set(range(8)))
    monkeypatch.setattr(workers, "_siblings", lambda number: f"{number % 4},{number % 4 + 4}")
    monkeypatch.setattr(workers, "_granted", lambda: 16)
    assert workers.LocalSpec("local", threads=1, jobs="auto").workers == 4
    monkeypatch.setattr(workers, "_granted", lambda: 3)
    assert workers.cores() == 3 and workers.LocalSpec("local", threads=1, jobs=7).workers == 7
    monkeypatch.setattr(workers, "_granted", lambda: 0)  # less than one core's worth
    assert workers.cores() == 1


OWNER = """
from formctl.engines.workers import Processes
from tests.formctl.test_workers import work
left = iter(["hang"])
list(Processes(1, 60).run(work, lambda: next(left, None), lambda request, note: print(note["pid"], flush=True)))
"""


def test_a_killed_owner_takes_its_workers_along():
    """They would work on what the next owner hands out again."""
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    owner = subprocess.Popen([sys.executable, "-c", OWNER], stdout=subprocess.PIPE, env=environment)
    assert owner.stdout is not None
    worker = int(owner.stdout.readline())
    owner.kill()
    owner.wait()
    deadline = time.monotonic() + 30
    while Path(f"/proc/{worker}").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not Path(f"/proc/{worker}").exists()
