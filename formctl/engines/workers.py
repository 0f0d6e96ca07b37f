"""Worker processes on this machine: one owner hands out requests and hears how they go; any worker may die at any time.

Workers are forked from a server process that has imported the heavy libraries once: a new one is there in
milliseconds. Each has one thread of arithmetic unless its work asks for more, and leaves the terminal's process group:
Ctrl-C reaches the owner alone, which asks them to save. ``Processes`` is the engine of a search, where a lost worker
is somebody's trial to go on with; ``share`` is for a list of requests that nobody goes on without.
"""

import math
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext, ForkServerProcess
from typing import Any, TypeVar

from formctl.engines.engine import Finished, Note, Request, Result, Withdrawn, WorkerLost

TICK = 1.0
"""s between two looks for new requests while a worker is idle."""

FAREWELL = 120.0
"""s that workers have to save when all is stopped."""

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""What libraries of arithmetic read when they are loaded."""

HEAVY = (
    "formctl.settings",
    "formctl.training",
    "formctl.evaluation.evaluate",
    "formctl.evaluation.methods",
    "envs.bank",
    "torch._dynamo",
)
"""Imported once for all workers; the first step of any optimizer imports the last one."""

Asked = TypeVar("Asked")
Answer = TypeVar("Answer")


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share(function: Callable[[Asked], Answer], requests: Sequence[Asked], jobs: int) -> Iterator[tuple[int, Answer]]:
    """Yield (index, result) of every request as they get ready, ``jobs`` at a time, each in a process of its own.

    The function and the requests have to be picklable. An exception of the function is raised here.
    Raises WorkerLost when a worker dies: killed, or out of memory.
    """
    left = iter(enumerate(requests))
    pool = Processes(min(jobs, len(requests)), math.inf, HEAVY)
    finished = pool.run(_Plain(function), lambda: next(left, None), lambda request, note: None)
    with closing(finished):  # type: ignore[type-var]  # it is a generator
        for item in finished:
            if item.error is not None:
                raise item.error
            yield item.request[0], item.result  # type: ignore[misc]  # there is a result where there is no error


class _Plain:
    """A function of a request as an engine wants it: with a number to know the request by, and with nothing to tell."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self.function = function

    def __call__(self, numbered: tuple[int, Any], emit: Callable[[Note], None]) -> Any:
        return self.function(numbered[1])


class Worker:
    """A process that runs one request after another."""

    def __init__(self, context: ForkServerContext) -> None:
        self.connection, theirs = context.Pipe()
        self.process: ForkServerProcess = context.Process(target=_serve, args=(theirs,), daemon=True)
        with _single_threaded():
            self.process.start()
        theirs.close()
        self.request: Any = None
        self.heard = 0.0
        self._knows: Callable[..., Any] | None = None

    def begin(self, function: Callable[..., Any], request: Any) -> None:
        """Hand over a request, and the function where it is not the last one. One that is dead already is noticed by
        ``answer``."""
        self.request, self.heard = request, time.monotonic()
        with suppress(OSError):
            self.connection.send((None if function is self._knows else function, request))
        self._knows = function

    def answer(self) -> tuple[str, Any]:
        """The next thing the worker said; ``lost`` and why when it is gone."""
        try:
            self.heard = time.monotonic()
            kind, content = self.connection.recv()
        except (EOFError, OSError, pickle.UnpicklingError):
            return "lost", self._end()
        return kind, content

    def kill(self) -> None:
        """End it now."""
        with suppress(ProcessLookupError):
            self.process.kill()
        self._end()

    def _end(self) -> str:
        self.process.join(5)
        code = self.process.exitcode
        self.connection.close()
        if code is not None and code < 0:
            return f"process {self.process.pid} was killed by {signal.Signals(-code).name}"
        return f"process {self.process.pid} ended without an answer (exit code {code})"


class Processes:
    """``jobs`` processes side by side; one that is silent for ``silence`` s is taken for dead and killed."""

    def __init__(self, jobs: int, silence: float, preload: Sequence[str] = ()) -> None:
        self.jobs, self.silence, self.preload = jobs, silence, list(preload)

    def run(
        self,
        function: Callable[[Request, Callable[[Note], None]], Result],
        draw: Callable[[], Request | None],
        listen: Callable[[Request, Note], None],
    ) -> Iterator[Finished[Request, Result]]:
        """See ``formctl.engines.engine.Engine``."""
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(self.preload)
        workers: list[Worker] = []
        try:
            while True:
                self._fill(context, workers, function, draw)
                busy = [worker for worker in workers if worker.request is not None]
                if not busy:
                    return
                ready = wait([worker.connection for worker in busy], TICK)
                for worker in busy:
                    if worker.connection in ready:
                        yield from self._hear(worker, workers, listen)
                    elif time.monotonic() - worker.heard > self.silence:
                        worker.kill()
                        workers.remove(worker)
                        silent = f"process {worker.process.pid} gave no sign of life for {self.silence:.0f} s"
                        yield Finished(worker.request, None, WorkerLost(silent))
        finally:
            _dismiss(workers)

    def _fill(
        self,
        context: ForkServerContext,
        workers: list[Worker],
        function: Callable[..., Any],
        draw: Callable[[], Request | None],
    ) -> None:
        """Give every idle or absent worker a request, as long as there are requests."""
        while True:
            idle = next((worker for worker in workers if worker.request is None), None)
            if (idle is None and len(workers) >= self.jobs) or (request := draw()) is None:
                return
            if idle is None:
                idle = Worker(context)
                while (idle.process.pid or 0) <= 0:  # killed before it could say who it is: that is no number to signal
                    idle = Worker(context)
                workers.append(idle)
            idle.begin(function, request)

    def _hear(
        self, worker: Worker, workers: list[Worker], listen: Callable[[Any, Note], None]
    ) -> Iterator[Finished[Any, Any]]:
        """One answer of a worker; what it means for its request, if it ends it."""
        kind, content = worker.answer()
        request = worker.request
        if kind == "note":
            try:
                listen(request, content)
            except Withdrawn as error:
                worker.kill()
                workers.remove(worker)
                yield Finished(request, None, error)
            return
        worker.request = None
        if kind == "lost":
            workers.remove(worker)
            yield Finished(request, None, WorkerLost(content))
        else:
            yield Finished(request, *((content, None) if kind == "done" else (None, content)))


def _dismiss(workers: Sequence[Worker]) -> None:
    """Let idle workers go and ask busy ones to save and stop; what does not in time, or a second Ctrl-C, ends hard."""
    try:
        for worker in workers:
            if worker.request is None:
                worker.connection.close()
            else:
                with suppress(ProcessLookupError):
                    worker.process.terminate()
        deadline = time.monotonic() + FAREWELL
        for worker in workers:
            while worker.process.is_alive() and time.monotonic() < deadline:
                with suppress(EOFError, OSError):  # a full pipe would keep it from saving
                    while worker.connection.poll():
                        if worker.connection.recv()[0] != "note":  # it could not stop: it has an answer, and wants more
                            worker.connection.close()
                worker.process.join(0.05)
    finally:
        for worker in workers:
            worker.process.kill()


def _serve(connection: Connection) -> None:
    """What a worker does: requests from ``connection``, answers into it, until it closes."""
    os.setsid()
    threading.Thread(target=_follow_owner, daemon=True).start()
    function: Callable[..., Any] | None = None
    while True:
        try:
            other, request = connection.recv()
        except (EOFError, OSError):
            return
        function = other or function
        assert function is not None
        try:
            answer = ("done", function(request, lambda note: connection.send(("note", note))))
        except KeyboardInterrupt:
            return  # asked to stop, and saved
        except Exception as error:  # told to the owner, which records it
            answer = ("error", error)
        connection.send_bytes(_packed(*answer))


def _follow_owner() -> None:
    """An owner that was killed takes its workers along: somebody else will hand out their requests."""
    owner = multiprocessing.parent_process()
    assert owner is not None
    owner.join()
    os.kill(os.getpid(), signal.SIGKILL)


def _packed(kind: str, content: Any) -> bytes:
    """An answer as it goes through the pipe; what does not survive that becomes an error that says so."""
    try:
        packed = pickle.dumps((kind, content))
        if kind == "error":
            pickle.loads(packed)
    except Exception as error:  # any class may do anything in its own pickling
        said = content if kind == "error" else error
        return pickle.dumps(("error", RuntimeError(f"{type(said).__name__}: {said}")))
    return packed


@contextmanager
def _single_threaded() -> Iterator[None]:
    """What is started in the block uses one thread: the server of all workers, with the first of them."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)
