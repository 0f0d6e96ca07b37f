"""Trials on a Ray cluster: the same function, one task each; a node that dies gives its trials back.

Every host has to reach the runs folder under the same path. What a task emits travels through a mailbox actor.
"""

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Ge, Gt

from formctl.engines.engine import (
    Count,
    Engine,
    EngineSpec,
    Finished,
    Note,
    Request,
    Result,
    Withdrawn,
    WorkerLost,
)
from formctl.engines.workers import TICK
from formctl.store.files import StoreError


class Mailbox:
    """Where tasks leave their notes for the owner; an actor that needs no processor of its own."""

    def __init__(self) -> None:
        self.notes: list[tuple[int, Note]] = []

    def put(self, task: int, note: Note) -> None:
        self.notes.append((task, note))

    def take(self) -> list[tuple[int, Note]]:
        taken, self.notes = self.notes, []
        return taken


@dataclass(frozen=True)
class RaySpec(EngineSpec):
    """A Ray cluster."""

    address: str  # auto: the cluster that this host belongs to; local: one on this machine; or HOST:PORT
    jobs: Count  # most trials side by side
    cpus: Annotated[float, Gt(0)]  # that a trial takes
    gpus: Annotated[float, Ge(0)]  # that a trial takes; fractions share one

    @property
    def workers(self) -> int:
        """The most tasks side by side."""
        return self.jobs

    def build(self, silence: float) -> Engine:
        """The engine; a task that gives no sign of life for ``silence`` s is taken for dead."""
        return Cluster(self, silence)


class Cluster:
    """As many tasks side by side as the cluster has room for, and at most ``jobs``."""

    def __init__(self, spec: RaySpec, silence: float) -> None:
        self.spec, self.silence = spec, silence

    def run(
        self,
        function: Callable[[Request, Callable[[Note], None]], Result],
        draw: Callable[[], Request | None],
        listen: Callable[[Request, Note], None],
    ) -> Iterator[Finished[Request, Result]]:
        """See ``formctl.engines.engine.Engine``."""
        ray = connect(self.spec)
        mailbox = ray.remote(num_cpus=0)(Mailbox).remote()
        task = ray.remote(num_cpus=self.spec.cpus, num_gpus=self.spec.gpus, max_retries=0)(_task)
        running: dict[Any, tuple[int, Any]] = {}
        heard: dict[int, float] = {}
        count = 0
        try:
            while True:
                while len(running) < self._room(ray) and (request := draw()) is not None:
                    count += 1
                    running[task.remote(function, request, mailbox, count)] = count, request
                    heard[count] = time.monotonic()
                if not running:
                    return
                ready, _ = ray.wait(list(running), timeout=TICK)
                yield from _hear(ray, mailbox, running, heard, listen)
                for reference in ready:
                    if reference in running:
                        yield _ended(ray, reference, running.pop(reference)[1])
                yield from self._silent(ray, running, heard)
        finally:
            for reference in running:
                ray.cancel(reference, force=True)
            ray.kill(mailbox)

    def _room(self, ray: Any) -> int:
        """Trials that the cluster can hold now; nodes come and go."""
        there = ray.cluster_resources()
        room = int(there.get("CPU", 0) // self.spec.cpus)
        if self.spec.gpus:
            room = min(room, int(there.get("GPU", 0) / self.spec.gpus))
        return min(self.spec.jobs, room)

    def _silent(
        self, ray: Any, running: dict[Any, tuple[int, Any]], heard: dict[int, float]
    ) -> Iterator[Finished[Any, Any]]:
        """Tasks of which nothing is heard any more."""
        for reference, (number, request) in list(running.items()):
            if time.monotonic() - heard[number] > self.silence:
                ray.cancel(reference, force=True)
                del running[reference]
                yield Finished(request, None, WorkerLost(f"no sign of life for {self.silence:.0f} s"))


def connect(spec: RaySpec) -> Any:
    """Ray, connected. Raises StoreError where it is not installed or the cluster cannot be reached."""
    try:
        import ray
    except ImportError as error:
        raise StoreError("engine=ray needs Ray: pip install 'formctl[ray]'") from error
    if ray.is_initialized():
        return ray
    settings: dict[str, Any] = {"address": spec.address}
    if spec.address == "local":  # a cluster of one's own is nobody else's business
        settings |= {"include_dashboard": False, "_node_ip_address": "127.0.0.1"}
    try:
        ray.init(log_to_driver=False, logging_level=logging.ERROR, **settings)
    except Exception as error:  # Ray raises plain ones as well
        why = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
        remedy = "engine=local needs no Ray" if spec.address == "local" else "engine.address=local starts one here"
        raise StoreError(f"engine.address={spec.address} cannot be reached: {why}; {remedy}") from error
    return ray


def _task(function: Callable[..., Any], request: Any, mailbox: Any, number: int) -> Any:
    """What runs on a node."""
    return function(request, lambda note: mailbox.put.remote(number, dict(note)))


def _hear(
    ray: Any,
    mailbox: Any,
    running: dict[Any, tuple[int, Any]],
    heard: dict[int, float],
    listen: Callable[[Any, Note], None],
) -> Iterator[Finished[Any, Any]]:
    """Pass notes on; end the tasks whose results are no longer wanted."""
    by_number = {number: (reference, request) for reference, (number, request) in running.items()}
    for number, note in ray.get(mailbox.take.remote()):
        reference, request = by_number.get(number, (None, None))
        if reference not in running:
            continue
        heard[number] = time.monotonic()
        try:
            listen(request, note)
        except Withdrawn as error:
            ray.cancel(reference, force=True)
            del running[reference]
            yield Finished(request, None, error)


def _ended(ray: Any, reference: Any, request: Any) -> Finished[Any, Any]:
    """How a task ended."""
    try:
        return Finished(request, ray.get(reference), None)
    except ray.exceptions.RayTaskError as error:
        return Finished(request, None, error.cause if isinstance(error.cause, Exception) else error)
    except ray.exceptions.RayError as error:  # the worker process, its node, or its memory
        return Finished(request, None, WorkerLost(str(error).splitlines()[0]))
