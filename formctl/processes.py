"""The processes of one training: started on this machine, or met where torchrun started them on several.

Every process flies an equal share of the environments; gradients are averaged (``algos.replicas``). Rank 0 is the
process of the command, which keeps the run; the others end with it.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import torch
import torch.distributed as dist

from algos.replicas import ALONE, ReplicaLost, Replicas
from algos.trainer import TrainSettings, follow, share
from formctl.errors import RunFailed

START = 600.0
"""s that a process may take to start."""

WORTHWHILE = 1.25
"""Times the work of one process that several have to do together, so that several train."""


def launched() -> Replicas | None:
    """The processes that torchrun has started, or None where it has not."""
    if "TORCHELASTIC_RUN_ID" not in os.environ or int(os.environ.get("WORLD_SIZE", "1")) == 1:
        return None
    return Replicas.join(int(os.environ["RANK"]), int(os.environ["WORLD_SIZE"]))


def led() -> bool:
    """Whether torchrun has started this process with another rank than 0."""
    return "TORCHELASTIC_RUN_ID" in os.environ and os.environ.get("RANK") != "0"


def serve(replicas: Replicas) -> None:
    """What a process of torchrun with another rank than 0 does. Raises RunFailed when another process is gone."""
    for number in (signal.SIGINT, signal.SIGTERM):  # torchrun tells everybody; rank 0 decides
        signal.signal(number, signal.SIG_IGN)
    torch.set_num_threads(1)
    try:
        follow(replicas)
    except ReplicaLost as lost:
        raise RunFailed(f"another process of the training is gone: {lost}") from lost
    replicas.leave()


class ProcessLost(RunFailed):
    """A process of the training died."""


@contextmanager
def replicas(count: int) -> Iterator[Replicas]:
    """This process as rank 0 of ``count``; the others are started, and end with the block.

    Under torchrun they are there already. Raises ProcessLost when one of them dies.
    """
    if (found := launched()) is not None:
        with _led(found, []):
            yield found
        return
    if count == 1:
        yield ALONE
        return
    store = dist.TCPStore("127.0.0.1", 0, is_master=True, wait_for_workers=False)
    started = [_start(store.port, rank, count) for rank in range(1, count)]
    try:
        _wait(store, started)
        group = Replicas.join(0, count, store)
        with _led(group, started):
            yield group
    finally:
        for process in started:
            process.kill()
            process.wait()


@contextmanager
def _led(group: Replicas, started: list["subprocess.Popen[bytes]"]) -> Iterator[None]:
    """While the block lasts the others follow; at its end they are let go."""
    try:
        yield
        with suppress(ReplicaLost):
            group.tell("end")
        for process in started:
            with suppress(subprocess.TimeoutExpired):
                process.wait(10)
    except ReplicaLost as lost:
        raise ProcessLost(f"a process of the training is gone: {_ending(started) or lost}") from lost
    finally:
        group.leave()


def _start(port: int, rank: int, count: int) -> "subprocess.Popen[bytes]":
    """Start one process, out of reach of the terminal's Ctrl-C."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    os.environ.setdefault("GLOO_SOCKET_IFNAME", "lo0" if sys.platform == "darwin" else "lo")
    path = os.pathsep.join(word for word in (str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH")) if word)
    command = [sys.executable, "-m", "formctl.replica", *map(str, (port, rank, count))]
    return subprocess.Popen(
        command, env=os.environ | threads | {"PYTHONPATH": path}, stdin=subprocess.DEVNULL, start_new_session=True
    )


def _wait(store: dist.TCPStore, started: list["subprocess.Popen[bytes]"]) -> None:
    """Until all processes have said that they are there. Raises RunFailed for one that is not."""
    deadline = time.monotonic() + START
    for rank, process in enumerate(started, 1):
        while not store.check([f"started/{rank}"]):
            time.sleep(0.05)
            if process.poll() is not None or time.monotonic() > deadline:
                raise RunFailed(f"a process of the training did not start: {_ending(started) or 'no answer'}")


def _ending(started: list["subprocess.Popen[bytes]"]) -> str | None:
    """How the first process that has ended did, in words."""
    time.sleep(0.2)  # a connection is closed a little earlier than its process is
    for process in started:
        if (code := process.poll()) is not None:
            how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
            return f"process {process.pid} {how}"
    return None


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def chosen(asked: int | str, settings: TrainSettings) -> tuple[int, str]:
    """How many processes train, and why, in words (empty where the call says how many).

    Raises ValueError where the environments do not divide into those asked for.
    """
    algos = [settings.algo, *(period.algo for period in settings.curriculum.periods if period.algo is not None)]
    if asked != "auto":
        for algo in algos:
            share(algo, int(asked))
        return int(asked), ""
    fitting = [n for n in range(2, cores() + 1) if all(_divides(algo, n) for algo in algos)]
    if not fitting:
        return 1, "one process: there is one core, or the learner does not divide"
    most = fitting[-1]
    gain = speed(most) / speed(1)
    said = f"{most} processes do {gain:.2f} times the work of one"
    return (most, said) if gain >= WORTHWHILE else (1, f"{said}: one trains")


def _divides(algo: object, processes: int) -> bool:
    try:
        share(algo, processes)  # type: ignore[arg-type]
    except ValueError:
        return False
    return True


PROBE = """
import sys, time, torch
torch.set_num_threads(1)
weights, rows = torch.randn(64, 64), torch.randn(192, 64)
print("ready", flush=True)
sys.stdin.readline()
end, count = time.perf_counter() + 1.0, 0
while time.perf_counter() < end:
    rows = (rows @ weights).tanh()
    count += 1
print(count)
"""
"""Arithmetic of a learner's size for a second; begins when it is told to."""


def speed(processes: int) -> float:
    """Layers per second that so many processes compute side by side, measured for one second."""
    started = [
        subprocess.Popen(
            [sys.executable, "-c", PROBE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        )
        for _ in range(processes)
    ]
    answers = []
    for process in started:
        assert process.stdout is not None
        process.stdout.readline()
    for process in started:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    for process in started:
        out, _ = process.communicate()
        answers.append(float(out or 0))
    return sum(answers)
