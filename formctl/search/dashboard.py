"""optuna-dashboard, read-only: it follows the study, and whatever is clicked there neither locks nor changes it.

A SQLite file that others write to is looked at through a copy, made anew while somebody looks; PostgreSQL is asked by
connections that may only read. Requests that would change something are refused before they get that far.
"""

import sqlite3
import tempfile
import threading
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from socketserver import ThreadingMixIn
from typing import TYPE_CHECKING, Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from formctl.console import say
from formctl.search import storage
from formctl.search.ledger import Ledger
from formctl.search.patience import Patience
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from optuna.storages import RDBStorage

PORT = 8080
"""Taken if it is free."""

PAUSE = 5.0
"""s that a copy is good for, at least."""

READING = ("GET", "HEAD")
REFUSAL = b"This dashboard only shows the study: nothing can be changed here."

Application = Callable[[dict[str, Any], Any], Iterable[bytes]]


class Mirror:
    """A copy of a SQLite study in ``folder``; safe to make while others write to the study."""

    def __init__(self, study: Ledger, folder: Path) -> None:
        self.study, self.path = study, folder / "study.db"
        self._patience, self._one = Patience(PAUSE), threading.Lock()
        self.refresh()

    def refresh(self) -> None:
        """Copy the study as it is now, unless that was done a moment ago."""
        with self._one:
            if not self._patience.due():
                return
            with (
                self._patience.spend(),
                storage.troubles(self.study.url),
                closing(sqlite3.connect(f"file:{self.study.url.database}?mode=ro", uri=True, timeout=30)) as source,
                closing(sqlite3.connect(self.path, timeout=30)) as target,
            ):
                source.backup(target)


def source(study: Ledger, folder: Path) -> "tuple[RDBStorage, Callable[[], None]]":
    """What the dashboard reads, and what brings it up to date. ``folder`` is for a copy, where one is needed."""
    from formctl.search.study import open_storage

    if study.url.drivername == "sqlite":
        mirror = Mirror(study, folder)
        return open_storage(storage.sqlite(mirror.path)), mirror.refresh
    with storage.troubles(study.url):
        return open_storage(storage.read_only(study.url)), lambda: None


def guarded(application: Application, refresh: Callable[[], None]) -> Application:
    """The application without its ways to change something; ``refresh`` is called before the others."""

    def answer(request: dict[str, Any], start: Any) -> Iterable[bytes]:
        if request["REQUEST_METHOD"] not in READING:
            start("405 Method Not Allowed", [("Content-Type", "text/plain"), ("Allow", ", ".join(READING))])
            return [REFUSAL]
        refresh()
        return application(request, start)

    return answer


class Server(ThreadingMixIn, WSGIServer):
    """Answers several requests at once: browsers keep connections open that they may need later."""

    daemon_threads = True


class Quiet(WSGIRequestHandler):
    """Does not print every request."""

    def log_message(self, format: str, *args: object) -> None:
        return


def server(application: Application, port: int = PORT) -> WSGIServer:
    """A server for this host only, at ``port`` or, where that is taken, at any that is free."""
    try:
        return make_server("127.0.0.1", port, application, Server, Quiet)
    except OSError:
        return make_server("127.0.0.1", 0, application, Server, Quiet)


def serve(study: Ledger) -> None:
    """Show the study until Ctrl-C. Raises StoreError where optuna-dashboard is missing."""
    try:
        import optuna_dashboard
    except ImportError as error:
        raise StoreError("--dashboard needs optuna-dashboard: pip install 'formctl[dashboard]'") from error
    with tempfile.TemporaryDirectory(prefix="formctl-dashboard-") as folder:
        backend, refresh = source(study, Path(folder))
        with server(guarded(optuna_dashboard.wsgi(backend), refresh)) as serving:
            say(f"study {study.name}, read-only: http://127.0.0.1:{serving.server_port}/ (Ctrl-C ends it)")
            try:
                serving.serve_forever()
            except KeyboardInterrupt:
                return
