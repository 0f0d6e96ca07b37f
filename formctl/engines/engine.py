"""Where work runs. An engine is given a function and requests; it decides the place, never the work.

The function takes one request and an ``emit`` for what should be known before it is done (progress, a learning
curve). Requests, emitted notes and results are plain picklable data, so that the same function runs in this process, in
a worker process or on another host. Results come back in the order they are ready, to one owner that writes them down.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Generic, Protocol, TypeVar

from annotated_types import Ge

from formctl.errors import RunFailed, Withdrawn

Request = TypeVar("Request")
Result = TypeVar("Result")

Note = Mapping[str, Any]
Emit = Callable[[Note], None]

Count = Annotated[int, Ge(1)]


@dataclass(frozen=True)
class EngineSpec:
    """What all engines have in common (``conf/engine/``)."""

    name: str
    threads: Count  # torch threads per process


class WorkerLost(RunFailed):
    """The process or node that worked on a request is gone; the request may be handed out again."""


@dataclass(frozen=True)
class Finished(Generic[Request, Result]):
    """A request that is through: its result, or the error that ended it."""

    request: Request
    result: Result | None
    error: Exception | None


class Engine(Protocol):
    """Runs ``function`` on every request."""

    def run(
        self,
        function: Callable[[Request, Emit], Result],
        draw: Callable[[], Request | None],
        listen: Callable[[Request, Note], None],
    ) -> Iterator[Finished[Request, Result]]:
        """Yield each request as it finishes; ``listen`` hears its notes meanwhile and may raise Withdrawn.

        Requests are drawn as room appears; None means that there is nothing to do now, and with nothing running
        either, the end. An exception of the function is handed over in Finished, WorkerLost where its worker died,
        Withdrawn where ``listen`` raised it; KeyboardInterrupt ends the whole.
        """
        ...


class InProcess:
    """In this process, one request after another."""

    def run(
        self,
        function: Callable[[Request, Emit], Result],
        draw: Callable[[], Request | None],
        listen: Callable[[Request, Note], None],
    ) -> Iterator[Finished[Request, Result]]:
        """See ``Engine``."""
        while (request := draw()) is not None:
            try:
                result = function(request, lambda note, request=request: listen(request, note))  # type: ignore[misc]
            except Exception as error:  # handed to the owner, which records it
                yield Finished(request, None, error)
            else:
                yield Finished(request, result, None)


__all__ = ["Count", "Emit", "Engine", "EngineSpec", "Finished", "InProcess", "Note", "Withdrawn", "WorkerLost"]
