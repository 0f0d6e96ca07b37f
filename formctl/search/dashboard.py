"""optuna-dashboard on a copy of the study: whatever is clicked there, the study is neither locked nor changed."""

import sqlite3
import tempfile
from contextlib import closing
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from formctl.console import say
from formctl.files import StoreError
from formctl.search import storage
from formctl.search.ledger import Ledger

if TYPE_CHECKING:
    from optuna.storages import RDBStorage

PORT = 8080


def snapshot(study: Ledger, path: Path) -> "RDBStorage":
    """The study as it is now in a SQLite file of its own at ``path``; safe while others write to it."""
    import optuna

    from formctl.search.study import open_storage

    copy = storage.sqlite(path)
    if study.url.drivername == "sqlite":
        with (
            storage.troubles(study.url),
            closing(sqlite3.connect(str(study.url.database), timeout=30)) as source,
            closing(sqlite3.connect(path)) as target,
        ):
            source.backup(target)
        return open_storage(copy)
    backend = open_storage(copy)
    with storage.troubles(study.url):
        optuna.copy_study(
            from_study_name=study.name,
            from_storage=open_storage(study.url),
            to_storage=backend,
            to_study_name=study.name,
        )
    return backend


def serve(study: Ledger, port: int = PORT) -> None:
    """Show a snapshot on this host only, until Ctrl-C. Raises StoreError where optuna-dashboard is missing."""
    try:
        import optuna_dashboard
    except ImportError as error:
        raise StoreError("--dashboard needs optuna-dashboard: pip install 'formctl[dashboard]'") from error
    with tempfile.TemporaryDirectory(prefix="formctl-dashboard-") as folder:
        backend = snapshot(study, Path(folder) / "study.db")
        say(f"study {study.name} as of {datetime.now():%H:%M:%S}, a copy: http://127.0.0.1:{port}/ (Ctrl-C ends it)")
        try:
            optuna_dashboard.run_server(backend, host="127.0.0.1", port=port)
        except KeyboardInterrupt:
            return
