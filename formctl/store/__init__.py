"""The store: what a run folder is, where its result comes from, and how its files are kept whole."""

from formctl.store.files import StoreError
from formctl.store.run import (
    KINDS,
    SCHEMA,
    STATUSES,
    LiveRun,
    Run,
    check_name,
    create,
    latest,
    new_id,
    now,
    resolve,
    scan,
)

__all__ = [
    "KINDS",
    "SCHEMA",
    "STATUSES",
    "LiveRun",
    "Run",
    "StoreError",
    "check_name",
    "create",
    "latest",
    "new_id",
    "now",
    "resolve",
    "scan",
]
