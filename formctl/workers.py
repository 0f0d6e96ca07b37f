"""Work shared by processes of this machine: plain pickled requests and results, one thread of arithmetic each.

A worker lives as long as its pipe: when this process goes away, however it goes, its workers finish the request at hand
and leave. Ctrl-C reaches this process only, which ends them.
"""

import os
import pickle
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any, TypeVar

from formctl.errors import RunFailed

if TYPE_CHECKING:
    from multiprocessing.context import SpawnProcess

Request = TypeVar("Request")
Result = TypeVar("Result")

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""What libraries of arithmetic read when they are loaded."""


class WorkerLost(RunFailed):
    """A worker process ended in the middle of its work."""


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share(
    function: Callable[[Request], Result], requests: Sequence[Request], jobs: int
) -> Iterator[tuple[int, Result]]:
    """Yield (index, result) of every request as they get ready, ``jobs`` at a time, each in a process of its own.

    The function and the requests have to be picklable. An exception of the function is raised here.
    Raises WorkerLost when a worker dies: killed, or out of memory.
    """
    waiting = deque(range(len(requests)))
    crew: dict[Connection, SpawnProcess] = {}
    busy: dict[Connection, int] = {}

    def assign(link: Connection) -> None:
        if waiting:
            busy[link] = waiting.popleft()
            _send(link, requests[busy[link]])

    try:
        with _quiet_start():
            for _ in range(min(jobs, len(requests))):
                link, process = _hire()
                crew[link] = process
        for link in crew:
            _send(link, function)
            assign(link)
        while busy:
            for ready in wait(list(busy)):
                assert isinstance(ready, Connection)
                index, result = busy.pop(ready), _result(ready, crew[ready])
                assign(ready)
                yield index, result
    finally:
        _dismiss(crew)


def _hire() -> "tuple[Connection, SpawnProcess]":
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs,), daemon=True)
    process.start()
    theirs.close()  # the worker's copy is the only one left: its end is noticed
    return ours, process


def _dismiss(crew: "dict[Connection, SpawnProcess]") -> None:
    for link, process in crew.items():
        link.close()
        process.terminate()
    for process in crew.values():
        process.join()


def _work(link: Connection) -> None:
    """A worker's life: the function first, then one request after another until the pipe is closed."""
    try:
        function = pickle.loads(link.recv_bytes())
        while True:
            request = pickle.loads(link.recv_bytes())
            try:
                answer: tuple[Any, Exception | None] = (function(request), None)
            except Exception as error:  # raised again by the process that asked
                answer = (None, error)
            link.send_bytes(_packed(answer))
    except (EOFError, OSError):  # nobody is there any more
        return


def _packed(answer: tuple[Any, Exception | None]) -> bytes:
    """Bytes of an answer; an exception that does not survive pickling becomes its description."""
    error = answer[1]
    try:
        packed = pickle.dumps(answer)
        if error is not None:
            pickle.loads(packed)
    except Exception:  # any class may do anything in its own pickling
        return pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))
    return packed


def _send(link: Connection, content: object) -> None:
    try:
        link.send_bytes(pickle.dumps(content))
    except BrokenPipeError:  # it has died: reading from it says how
        return


def _result(link: Connection, process: "SpawnProcess") -> Any:
    try:
        result, error = pickle.loads(link.recv_bytes())
    except (EOFError, ConnectionResetError) as lost:
        process.join()
        code = process.exitcode or 0
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"left with exit code {code}"
        raise WorkerLost(f"worker process {process.pid} {how}") from lost
    if error is not None:
        raise error
    return result


@contextmanager
def _quiet_start() -> Iterator[None]:
    """Processes started in the block use one thread and never see Ctrl-C; both are inherited at their start."""
    before = {name: os.environ.get(name) for name in THREADS}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
