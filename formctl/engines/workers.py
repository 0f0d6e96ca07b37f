"""Worker processes on this machine, from the standard library's pools; any of them may die at any time.

Workers are forked from a server process that has imported the heavy libraries once: a new one is there in
milliseconds. Each has one thread of arithmetic unless its work asks for more, and a session of its own: Ctrl-C and the
end of a terminal reach the owner alone, which asks them to save. ``Processes`` is the engine of a search, where a
lost worker is somebody's trial to go on with; ``share`` is for a fixed list of requests, all of which are needed.
"""

import math
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, suppress
from dataclasses import dataclass
from multiprocessing import forkserver
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Any, Literal, TypeVar

from formctl.engines.engine import (
    Count,
    Engine,
    EngineSpec,
    Finished,
    InProcess,
    Note,
    Request,
    Result,
    Withdrawn,
    WorkerLost,
)
from formctl.interrupts import outlive_audience

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


@dataclass(frozen=True)
class LocalSpec(EngineSpec):
    """Processes on this machine."""

    jobs: Count | Literal["auto"]  # trials side by side; auto: one for each core that helps

    @property
    def workers(self) -> int:
        """The number of processes."""
        return cores() if self.jobs == "auto" else self.jobs

    def build(self, silence: float) -> Engine:
        """The engine; a worker that gives no sign of life for ``silence`` s is taken for dead."""
        return InProcess() if self.workers == 1 else Processes(self.workers, silence, HEAVY)


def cores() -> int:
    """Cores that help: physical ones among those this process may use, and no more than its container is granted."""
    usable = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    physical = {_siblings(number) for number in usable}
    return max(1, min(len(physical), _granted()))


def _siblings(number: int) -> str:
    """The hardware threads of the core that has thread ``number``; itself where nobody knows."""
    try:
        return Path(f"/sys/devices/system/cpu/cpu{number}/topology/thread_siblings_list").read_text(encoding="ascii")
    except OSError:
        return str(number)


def _granted() -> int:
    """Cores' worth of time that the control group has; as many as there are where it has no limit."""
    try:
        quota, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="ascii").split()
        return int(quota) // int(period)
    except (OSError, ValueError):
        return os.cpu_count() or 1


def share(function: Callable[[Asked], Answer], requests: Sequence[Asked], jobs: int) -> Iterator[tuple[int, Answer]]:
    """Yield (index, result) of every request as they get ready, ``jobs`` at a time, in processes of their own.

    The function and the requests have to be picklable. An exception of the function is raised here.
    Raises WorkerLost when a worker dies: killed, or out of memory.
    """
    left = iter(enumerate(requests))
    pool = Processes(min(jobs, len(requests)), math.inf, HEAVY)
    finished = pool.run(_Numbered(function), lambda: next(left, None), lambda request, note: None)
    with closing(finished):  # type: ignore[type-var]  # it is a generator
        for item in finished:
            if item.error is not None:
                raise item.error
            yield item.request[0], item.result  # type: ignore[misc]  # there is a result where there is no error


class _Numbered:
    """A function of a request as an engine wants it: with a number to know the request by, and with nothing to tell."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self.function = function

    def __call__(self, numbered: tuple[int, Any], emit: Callable[[Note], None]) -> Any:
        return self.function(numbered[1])


class Worker:
    """A process that runs one request after another, and says how it goes."""

    def __init__(self, preload: Sequence[str]) -> None:
        context = _context(preload)
        self.notes, theirs = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(1, context, initializer=_settle_in, initargs=(theirs,))
        try:
            self.pid: int = self._pool.submit(os.getpid).result()
        except BaseException:
            self._pool.shutdown(wait=False, cancel_futures=True)
            raise
        theirs.close()
        self.request: Any = None
        self.future: Future[Any] | None = None
        self.heard = 0.0

    def begin(self, function: Callable[..., Any], request: Any) -> None:
        """Hand over a request."""
        self.request, self.heard = request, time.monotonic()
        try:
            self.future = self._pool.submit(_run, function, request)
        except BrokenProcessPool as error:  # it died while it was idle
            self.future = Future()
            self.future.set_exception(error)

    def read(self) -> Note | None:
        """The next note; None where there is none, because the request is through or the worker gone."""
        try:
            if not self.notes.poll():
                return None
            note: Note = self.notes.recv()
        except (EOFError, OSError):
            return None
        self.heard = time.monotonic()
        return note

    def kill(self) -> None:
        """End it now."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)
        self.dismiss()

    def dismiss(self) -> None:
        """Let it go."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        self.notes.close()


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
        workers: list[Worker] = []
        try:
            while True:
                self._fill(workers, function, draw)
                busy = [worker for worker in workers if worker.future is not None]
                if not busy:
                    return
                wait([worker.notes for worker in busy], TICK)
                for worker in busy:
                    finished = self._hear(worker, listen)
                    if finished is not None:
                        worker.future, worker.request = None, None
                        if isinstance(finished.error, WorkerLost | Withdrawn):
                            workers.remove(worker)
                            worker.kill()
                        yield finished
        finally:
            _farewell(workers)

    def _fill(self, workers: list[Worker], function: Callable[..., Any], draw: Callable[[], Any | None]) -> None:
        """Give every idle or absent worker a request, as long as there are requests."""
        while True:
            idle = next((worker for worker in workers if worker.future is None), None)
            if (idle is None and len(workers) >= self.jobs) or (request := draw()) is None:
                return
            if idle is None:
                idle = Worker(self.preload)
                workers.append(idle)
            idle.begin(function, request)

    def _hear(self, worker: Worker, listen: Callable[[Any, Note], None]) -> Finished[Any, Any] | None:
        """What a worker has to say; not None when its request is through, one way or another."""
        assert worker.future is not None
        over = worker.future.done()  # asked first: after that there are no more notes
        try:
            while (note := worker.read()) is not None:
                if note:
                    listen(worker.request, note)
        except Withdrawn as error:
            return Finished(worker.request, None, error)
        if over or worker.future.done():
            failure = worker.future.exception()
            if failure is None:
                return Finished(worker.request, worker.future.result(), None)
            if isinstance(failure, BrokenProcessPool) or not isinstance(failure, Exception):  # asked to stop, not by us
                failure = WorkerLost(f"process {worker.pid} died: killed, or out of memory")
            return Finished(worker.request, None, failure)
        if time.monotonic() - worker.heard > self.silence:
            lost = WorkerLost(f"process {worker.pid} gave no sign of life for {self.silence:.0f} s")
            return Finished(worker.request, None, lost)
        return None


def _farewell(workers: Sequence[Worker]) -> None:
    """Ask busy workers to save and stop; what does not in time, or at a second Ctrl-C, ends hard."""
    busy = [worker for worker in workers if worker.future is not None]
    try:
        for worker in busy:
            with suppress(ProcessLookupError):
                os.kill(worker.pid, signal.SIGTERM)
        deadline = time.monotonic() + FAREWELL
        while any(not worker.future.done() for worker in busy if worker.future) and time.monotonic() < deadline:
            for worker in busy:
                while worker.read() is not None:  # a full pipe would keep it from saving
                    pass
            time.sleep(0.05)
    finally:
        for worker in workers:
            worker.kill()


def _context(preload: Sequence[str]) -> ForkServerContext:
    """The context in which workers are started. Their server, which imports what all of them need, is deaf to Ctrl-C
    and to the end of the terminal, and has one thread of arithmetic; both are handed down to every worker."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(preload))
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    heard = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, heard)
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.__setitem__(name, value)
    return context


_notes: Connection | None = None  # of a worker: where its notes go


def _settle_in(notes: Connection | None = None) -> None:
    """What a worker does before its first request."""
    global _notes
    _notes = notes
    os.setsid()
    outlive_audience()
    threading.Thread(target=_follow_owner, daemon=True).start()


def _run(function: Callable[..., Any], request: Any) -> Any:
    """A request in a worker."""
    notes = _notes
    assert notes is not None
    try:
        return function(request, notes.send)
    finally:
        notes.send({})  # wakes the owner


def _follow_owner() -> None:
    """An owner that was killed takes its workers along: somebody else will hand out their requests."""
    owner = multiprocessing.parent_process()
    assert owner is not None
    owner.join()
    os.kill(os.getpid(), signal.SIGKILL)
