"""optuna-dashboard, read-only: it follows the study, and whatever is clicked there neither locks nor changes it."""

from collections.abc import Callable, Iterable
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

import sqlalchemy

from formctl.console import say
from formctl.search import database
from formctl.store.files import StoreError

PORT = 8080
"""Taken if it is free."""

READING = ("GET", "HEAD")
REFUSAL = b"This dashboard only shows the study: nothing can be changed here."

Application = Callable[[dict[str, Any], Any], Iterable[bytes]]


def reading_only(application: Application) -> Application:
    """The application without its ways to change something."""

    def answer(request: dict[str, Any], start: Any) -> Iterable[bytes]:
        if request["REQUEST_METHOD"] not in READING:
            start("405 Method Not Allowed", [("Content-Type", "text/plain"), ("Allow", ", ".join(READING))])
            return [REFUSAL]
        return application(request, start)

    return answer


class DashboardServer(ThreadingMixIn, WSGIServer):
    """Answers several requests at once: browsers keep connections open that they may need later."""

    daemon_threads = True


class QuietHandler(WSGIRequestHandler):
    """Does not print every request."""

    def log_message(self, format: str, *args: object) -> None:
        return


def server(application: Application, port: int = PORT) -> WSGIServer:
    """A server for this host only, at ``port`` or, where that is taken, at any that is free."""
    try:
        return make_server("127.0.0.1", port, application, DashboardServer, QuietHandler)
    except OSError:
        return make_server("127.0.0.1", 0, application, DashboardServer, QuietHandler)


def serve(name: str, url: sqlalchemy.URL) -> None:
    """Show the study until Ctrl-C. Raises StoreError where optuna-dashboard is missing."""
    try:
        import optuna_dashboard  # an extra
    except ImportError as error:
        raise StoreError("--dashboard needs optuna-dashboard: pip install 'formctl[dashboard]'") from error
    application = reading_only(optuna_dashboard.wsgi(database.open_storage(database.read_only(url))))
    with server(application) as serving:
        say(f"study {name}, read-only: http://127.0.0.1:{serving.server_port}/ (Ctrl-C ends it)")
        try:
            serving.serve_forever()
        except KeyboardInterrupt:
            return
