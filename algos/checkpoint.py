"""Files that survive crashes and cannot run code: plain containers and tensors, a content hash, atomic writes."""

import hashlib
import io
import os
import struct
from pathlib import Path
from typing import Any

import torch

FORMAT = "formctl-1"


class CheckpointError(ValueError):
    """A file that could not be written, or that is damaged, truncated or something else; one line, names the file."""


def save(path: str | Path, content: dict[str, Any], kind: str = "training") -> None:
    """Write `content` (nested dicts, lists, tuples, tensors, numbers, strings) so that a reader never sees half a file.

    The file is complete on disk under a temporary name before it takes the place of the old one; when anything fails,
    the old one stays. `kind` says what is in it (`training` state or `policy`).
    Raises CheckpointError when the folder is read-only, missing or the disk is full.
    """
    path = Path(path)
    buffer = io.BytesIO()
    torch.save({"format": FORMAT, "kind": kind, "sha256": digest(content), "content": content}, buffer)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        _write(temporary, buffer.getvalue())
        os.replace(temporary, path)
        _sync_folder(path.parent)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        kept = "; the last good file was kept" if path.exists() else ""
        raise CheckpointError(f"cannot write {path}: {error.strerror or error}{kept}") from error


def load(path: str | Path, kind: str = "training") -> dict[str, Any]:
    """The content of a file written by `save`, hash verified, on the CPU. Raises CheckpointError."""
    path = Path(path)
    try:
        document = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise CheckpointError(f"no such file: {path}") from error
    except Exception as error:  # torch raises a dozen types for damaged zips and pickles
        raise CheckpointError(f"{path} is damaged or not a formctl {kind} file ({type(error).__name__})") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT or "content" not in document:
        raise CheckpointError(f"{path} is not a formctl {kind} file")
    if document.get("kind") != kind:
        raise CheckpointError(f"{path} is a formctl {document.get('kind')} file, but a {kind} file is needed here")
    if document.get("sha256") != digest(document["content"]):
        raise CheckpointError(f"{path} is damaged: its content does not match its hash")
    return document["content"]


def digest(content: Any) -> str:
    """sha256 over types, structure and bytes; independent of how the file happens to be laid out."""
    state = hashlib.sha256()
    _feed(state, content)
    return state.hexdigest()


def _feed(state: Any, value: Any) -> None:
    if isinstance(value, torch.Tensor):
        state.update(f"tensor {value.dtype} {tuple(value.shape)};".encode())
        state.update(value.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    elif isinstance(value, dict):
        state.update(f"dict {len(value)};".encode())
        for key, item in value.items():
            _feed(state, key)
            _feed(state, item)
    elif isinstance(value, list | tuple):
        state.update(f"{'list' if isinstance(value, list) else 'tuple'} {len(value)};".encode())
        for item in value:
            _feed(state, item)
    elif isinstance(value, float):
        state.update(b"float " + struct.pack("<d", value))
    elif value is None or isinstance(value, bool | int | str):
        state.update(f"{type(value).__name__} {value!r};".encode())
    else:
        raise TypeError(f"a checkpoint holds tensors, numbers, strings and containers, not {type(value).__name__}")


def _write(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """Make the rename itself durable (POSIX: a folder is a file of its own)."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
