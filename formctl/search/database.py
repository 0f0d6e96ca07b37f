"""Where a study's database is, how it is opened, and what its troubles are called. Passwords stay in here."""

import logging
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import sqlalchemy
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from formctl.console import warn
from formctl.store.files import StoreError
from formctl.store.provenance import redact

if TYPE_CHECKING:
    from optuna.storages import RDBStorage

VARIABLE = "FORMCTL_STORAGE"
"""Environment variable that may hold the address, where a password on the command line would show in ``ps``."""

BUSY = 10.0
"""s that SQLite itself waits for a locked file, before it is said for whom."""

_DRIVERS = dict.fromkeys(("postgres", "postgresql", "postgresql+psycopg"), "postgresql+psycopg")

T = TypeVar("T")


def sqlite(path: Path) -> sqlalchemy.URL:
    """The address of a SQLite file."""
    return sqlalchemy.URL.create("sqlite", database=str(path.resolve()))


def read(text: str) -> sqlalchemy.URL:
    """The address that ``--storage`` means: ``postgresql://user:password@host:port/database``. Raises StoreError."""
    try:
        url = sqlalchemy.make_url(text)
    except ArgumentError as error:
        raise StoreError("--storage is no address; write postgresql://USER:PASSWORD@HOST:PORT/DATABASE") from error
    if url.drivername not in _DRIVERS:
        raise StoreError(
            f"--storage {url.drivername}:// is not supported; several hosts share postgresql://, one host needs none"
        )
    return url.set(drivername=_DRIVERS[url.drivername])


def given(text: str | None) -> sqlalchemy.URL | None:
    """The address from the option or the environment; None for SQLite in the run folder."""
    text = text or os.environ.get(VARIABLE)
    return read(text) if text else None


def shown(url: sqlalchemy.URL) -> str:
    """The address as people may read it: a file's path, or a server without a password."""
    if url.drivername == "sqlite":
        return str(url.database)
    url = url.set(drivername="postgresql")
    hidden = {key: "***" for key in url.query if "password" in key.lower()}
    return redact(url.update_query_dict(hidden).render_as_string(hide_password=True))


def read_only(url: sqlalchemy.URL) -> sqlalchemy.URL:
    """The address of the same database for connections that cannot write to it."""
    if url.drivername == "sqlite":
        return url.set(database=f"file:{url.database}").update_query_dict({"mode": "ro", "uri": "true"})
    return url.update_query_dict({"options": "-c default_transaction_read_only=on"})


def connect(url: sqlalchemy.URL) -> sqlalchemy.Engine:
    """An engine on the database; nothing is sent yet. Raises StoreError where the driver is missing."""
    try:
        return sqlalchemy.create_engine(url, **_options(url))
    except ImportError as error:
        raise StoreError(f"{shown(url)} needs a driver: pip install 'formctl[postgres]'") from error


def open_storage(url: sqlalchemy.URL, *, make: bool = False) -> "RDBStorage":
    """Optuna's storage there, its tables made where they are missing and ``make`` says so.

    Raises StoreError for a database that is none, or one of another version of Optuna.
    """
    import optuna  # takes a second, and telling how a study stands does without

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    logging.getLogger("alembic").setLevel(logging.WARNING)
    if not make and not attempt(url, lambda: sqlalchemy.inspect(connect(url)).has_table("studies")):
        raise StoreError(f"{shown(url)} is not a study of formctl (no trials in it)")
    address = url.render_as_string(hide_password=False).replace("{", "{{").replace("}", "}}")  # Optuna formats it
    try:
        return attempt(
            url,
            lambda: optuna.storages.RDBStorage(address, engine_kwargs=_options(url), skip_table_creation=not make),
        )
    except RuntimeError as error:  # it says what to type
        raise StoreError(f"{shown(url)} cannot be used: {' '.join(str(error).split())}") from error


@contextmanager
def written_ahead(url: sqlalchemy.URL) -> Iterator[None]:
    """A block in which readers of a SQLite file neither wait nor are waited for; after it, it is one plain file again.

    Where that cannot be had (a network's file system; somebody who still reads) the file stays as it is.
    """
    _set_journal(url, "WAL")
    try:
        yield
    finally:
        _set_journal(url, "DELETE")


def _set_journal(url: sqlalchemy.URL, mode: str) -> None:
    if url.drivername == "sqlite":
        with suppress(sqlite3.Error), closing(sqlite3.connect(str(url.database), timeout=1.0)) as connection:
            connection.execute(f"PRAGMA journal_mode={mode}")


def attempt(url: sqlalchemy.URL, act: Callable[[], T]) -> T:
    """Do something with the database. A file that another program has locked is waited for.

    Raises StoreError, one line, for a damaged, full, read-only, foreign or unreachable database.
    """
    waiting = False
    while True:
        try:
            return act()
        except Exception as error:
            if not (isinstance(error, SQLAlchemyError) or type(error).__name__ == "StorageInternalError"):
                raise
            cause = error.__cause__ or error
            lines = str(getattr(cause, "orig", None) or cause).strip().splitlines() or [type(cause).__name__]
            if "database is locked" not in lines[0]:
                raise StoreError(f"{shown(url)} cannot be used: {redact(_reason(lines))}") from error
        if not waiting:
            warn(f"{shown(url)} is locked by {holders(Path(str(url.database)))}; waiting for it to let go")
            waiting = True


def holders(path: Path) -> str:
    """The other processes that have a file open, as far as this user may see them."""
    found = set()
    for descriptor in Path("/proc").glob("[0-9]*/fd/*"):
        process = descriptor.parts[2]
        try:
            if process != str(os.getpid()) and os.readlink(descriptor) == str(path):
                name = Path("/proc", process, "comm").read_text(encoding="utf-8", errors="replace").strip()
                found.add(f"process {process} ({name})")
        except OSError:
            continue
    return ", ".join(sorted(found)) or "another program"


def _options(url: sqlalchemy.URL) -> dict[str, Any]:
    """How the database is connected to: a dead server or host is noticed, a busy file is waited for."""
    if url.drivername == "sqlite":
        return {"connect_args": {"timeout": BUSY}}
    alive = {"keepalives_idle": 30, "keepalives_interval": 10, "keepalives_count": 3}
    return {"pool_pre_ping": True, "connect_args": {"connect_timeout": 10, **alive}}


def _reason(lines: list[str]) -> str:
    """The line that says most: PostgreSQL lists every address it tried before it says what was wrong."""
    return next((line.strip(" -") for line in lines if "failed" in line), lines[0])
