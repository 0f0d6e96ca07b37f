"""The manifest of a published store: a hash of every file, so that anybody can tell whether it still is that."""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

from formctl.store.files import StoreError, read_json, write_json

NAME = "manifest.json"
LIMIT = 40_000_000
"""Bytes that a published store may have: it travels with the source."""
NOT_PUBLISHED = ("run.lock", "flown.jsonl")
"""What a run leaves behind that says nothing about its result."""


def write(root: Path) -> int:
    """Hash every file of a store into its manifest, after removing what is not published; returns the bytes of all.

    Raises StoreError for a store that is too large to travel.
    """
    for path in [path for name in NOT_PUBLISHED for path in root.rglob(name)]:
        path.unlink()
    hashes = {str(path.relative_to(root)): digest(path) for path in files(root)}
    total = sum(path.stat().st_size for path in files(root))
    if total > LIMIT:
        raise StoreError(f"{root} holds {total / 1e6:.1f} MB, at most {LIMIT / 1e6:.0f} are published: remove runs")
    write_json(root / NAME, {"bytes": total, "files": hashes})
    return total


def differences(root: Path) -> Iterator[tuple[Path, str]]:
    """Every file that is not what the manifest says, one that is missing, one that was added."""
    recorded: dict[str, str] = read_json(root / NAME)["files"]
    found = {str(path.relative_to(root)): path for path in files(root)}
    for name, known in recorded.items():
        if name not in found:
            yield root / name, "is missing"
        elif digest(found[name]) != known:
            yield root / name, "is not the published file"
    for name in sorted(found.keys() - recorded.keys()):
        yield root / name, f"is not in the manifest: formctl runs seal {root} takes it in"


def files(root: Path) -> list[Path]:
    """The files that are published, without the manifest itself."""
    return sorted(
        path for path in root.rglob("*") if path.is_file() and path.name not in NOT_PUBLISHED and path != root / NAME
    )


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def personal(root: Path) -> Iterator[Path]:
    """Records and settings that name an absolute path: of no use to anybody else, and nobody else's business."""
    for path in files(root):
        if path.name == "run.json":
            words = read_json(path).get("argv") or []
            if any(str(word).partition("=")[2].startswith("/") or str(word).startswith("/") for word in words):
                yield path
        elif path.name == "config.yaml" and "\nruns: /" in f"\n{path.read_text(encoding='utf-8')}":
            yield path


def text(root: Path) -> str:
    """How many files and bytes, in words."""
    recorded = json.loads((root / NAME).read_text(encoding="utf-8"))
    return f"{len(recorded['files'])} files, {recorded['bytes'] / 1e6:.1f} MB"
