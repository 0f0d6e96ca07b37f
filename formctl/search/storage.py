"""Where a study's database is, how it is opened, and what its troubles are called. Passwords stay in here."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import sqlalchemy
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from formctl.store.files import StoreError
from formctl.store.provenance import redact

VARIABLE = "FORMCTL_STORAGE"
"""Environment variable that may hold the address, where a password on the command line would show in ``ps``."""

_DRIVERS = {
    "postgres": "postgresql+psycopg",
    "postgresql": "postgresql+psycopg",
    "postgresql+psycopg": "postgresql+psycopg",
}


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
    """The address of the same PostgreSQL database for connections that cannot write to it."""
    return url.update_query_dict({"options": "-c default_transaction_read_only=on"})


def options(url: sqlalchemy.URL) -> dict[str, Any]:
    """How the database is connected to: a dead server or host is noticed, a busy file is waited for."""
    if url.drivername == "sqlite":
        return {"connect_args": {"timeout": 30}}
    alive = {"keepalives_idle": 30, "keepalives_interval": 10, "keepalives_count": 3}
    return {"pool_pre_ping": True, "connect_args": {"connect_timeout": 10, **alive}}


def connect(url: sqlalchemy.URL) -> sqlalchemy.Engine:
    """An engine on the database; nothing is sent yet. Raises StoreError where the driver is missing."""
    try:
        return sqlalchemy.create_engine(url, **options(url))
    except ImportError as error:
        raise StoreError(f"{shown(url)} needs a driver: pip install 'formctl[postgres]'") from error


@contextmanager
def troubles(url: sqlalchemy.URL) -> Iterator[None]:
    """Turn what a damaged, full, locked, read-only or unreachable database raises into one line."""
    try:
        yield
    except Exception as error:
        if not (isinstance(error, SQLAlchemyError) or type(error).__name__ == "StorageInternalError"):
            raise
        cause = error.__cause__ or error
        lines = str(getattr(cause, "orig", None) or cause).strip().splitlines() or [type(cause).__name__]
        raise StoreError(f"{shown(url)} cannot be used: {redact(_reason(lines))}") from error


def _reason(lines: list[str]) -> str:
    """The line that says most: PostgreSQL lists every address it tried before it says what was wrong."""
    return next((line.strip(" -") for line in lines if "failed" in line), lines[0])
