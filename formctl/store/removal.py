"""Taking a run out of the store, unless something that stays there still needs it."""

import shlex
import shutil
from pathlib import Path

from formctl import store
from formctl.store.files import StoreError, disk_errors


def refuse_needed(run: store.Run, root: Path) -> None:
    """Raise StoreError for a run that is at work, part of a study, or named as its source by another run."""
    if run.in_use():
        process = run.record.get("process", {})
        raise StoreError(
            f"{run.path} is at work: stop process {process.get('pid')} on {process.get('host')} first, or, where that "
            f"host is gone, type rm {shlex.quote(str(run.path / 'run.lock'))}"
        )
    if run.path.parent.name == "trials":
        raise StoreError(
            f"{run.path} is a trial of a study, which needs it: remove the study {run.path.parents[1].name}"
        )
    users = [other for other in store.scan(root) if other.path != run.path and needs(other, run)]
    if users:
        names = ", ".join(f"{user.kind}/{user.name}/{user.id}" for user in users[:3])
        more = f" and {len(users) - 3} more" if len(users) > 3 else ""
        raise StoreError(f"{run.path} is still needed by {names}{more}; remove those first")


def needs(other: store.Run, run: store.Run) -> bool:
    """Whether ``other`` was made from ``run`` or from one of its trials."""
    ids = {run.path.name} | {record.parent.name for record in run.path.glob("trials/*/run.json")}
    ids |= {str(store.Run(record.parent).record["id"]) for record in run.path.glob("trials/*/run.json")}
    return bool(ids & set(other.record.get("parents") or []))


def remove(run: store.Run, root: Path) -> int:
    """Delete the run's folder; it leaves the listing at once and in whole. Returns the bytes that were freed."""
    size = sum(path.stat().st_size for path in run.path.rglob("*") if path.is_file())
    aside = root / f".removed-{run.path.name}"
    with disk_errors(run.path):
        run.path.rename(aside)
        shutil.rmtree(aside)
        if not any(run.path.parent.iterdir()):
            run.path.parent.rmdir()
    return size
