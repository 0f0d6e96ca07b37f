"""Checkpoints survive damage, full disks and strangers."""

import errno
import os
import pickle
from pathlib import Path
from typing import Any

import pytest
import torch

from algos import checkpoint
from algos.checkpoint import CheckpointError

CONTENT: dict[str, Any] = {
    "weights": {"a": torch.arange(6.0).view(2, 3), "b": torch.tensor(True), "empty": torch.zeros(0, 2)},
    "numbers": [1, 2.5, None, False, "word"],
    "pair": (torch.tensor([1, 2], dtype=torch.int32), {"deep": float("inf")}),
    7: "an integer key",
}


def test_content_comes_back(tmp_path: Path) -> None:
    checkpoint.save(tmp_path / "a.pt", CONTENT)
    loaded = checkpoint.load(tmp_path / "a.pt")
    assert checkpoint.digest(loaded) == checkpoint.digest(CONTENT)
    torch.testing.assert_close(loaded["weights"], CONTENT["weights"])
    assert loaded["numbers"] == CONTENT["numbers"]
    assert [file.name for file in tmp_path.iterdir()] == ["a.pt"]


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c["weights"]["a"].__setitem__((0, 0), 1e-7),
        lambda c: c["numbers"].__setitem__(0, True),
        lambda c: c["numbers"].__setitem__(1, 2),
        lambda c: c.__setitem__("weights", {**c["weights"], "a": c["weights"]["a"].view(3, 2)}),
        lambda c: c.__setitem__("numbers", tuple(c["numbers"])),
    ],
)
def test_digest_sees_every_change(change: Any) -> None:
    copy = {**CONTENT, "numbers": list(CONTENT["numbers"]), "weights": dict(CONTENT["weights"])}
    copy["weights"]["a"] = copy["weights"]["a"].clone()
    assert checkpoint.digest(copy) == checkpoint.digest(CONTENT)
    change(copy)
    assert checkpoint.digest(copy) != checkpoint.digest(CONTENT)


def test_truncated_and_flipped_files(tmp_path: Path) -> None:
    path = tmp_path / "a.pt"
    checkpoint.save(path, CONTENT)
    whole = path.read_bytes()
    for size in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(CheckpointError, match=r"a\.pt is damaged"):
            checkpoint.load(path)
    value = CONTENT["weights"]["a"].numpy().tobytes()
    at = whole.index(value) + 5
    path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    with pytest.raises(CheckpointError, match=r"a\.pt is damaged"):
        checkpoint.load(path)


def test_content_that_does_not_match_its_hash(tmp_path: Path) -> None:
    path = tmp_path / "a.pt"
    checkpoint.save(path, CONTENT)
    document = torch.load(path, weights_only=True)
    document["content"]["numbers"][0] = 2
    torch.save(document, path)
    with pytest.raises(CheckpointError, match="does not match its hash"):
        checkpoint.load(path)


def test_foreign_files(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"no such file: .*missing\.pt"):
        checkpoint.load(tmp_path / "missing.pt")
    torch.save({"state": torch.zeros(1)}, tmp_path / "foreign.pt")
    with pytest.raises(CheckpointError, match="is not a formctl training file"):
        checkpoint.load(tmp_path / "foreign.pt")
    checkpoint.save(tmp_path / "policy.pt", {}, kind="policy")
    with pytest.raises(CheckpointError, match="is a formctl policy file, but a training file is needed"):
        checkpoint.load(tmp_path / "policy.pt")


class Trap:
    def __reduce__(self) -> tuple[Any, ...]:
        return (os.mkdir, ("sprung",))


def test_code_in_a_file_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({"format": checkpoint.FORMAT, "content": Trap()}, "trap.pt")
    Path("trap.pkl").write_bytes(pickle.dumps(Trap(), protocol=2))
    for name in ("trap.pt", "trap.pkl"):
        with pytest.raises(CheckpointError, match="is damaged or not a formctl training file"):
            checkpoint.load(name)
    assert not Path("sprung").exists()


def test_objects_are_refused_when_saving(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="not set"):
        checkpoint.save(tmp_path / "a.pt", {"seen": {1, 2}})


@pytest.mark.parametrize("step", ["write", "fsync", "replace"])
def test_last_good_file_survives_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    path = tmp_path / "a.pt"
    checkpoint.save(path, {"generation": 1})

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if step == "write":  # half of the bytes arrive, then the disk is full

        def half(target: Path, data: bytes) -> None:
            target.write_bytes(data[: len(data) // 2])
            full()

        monkeypatch.setattr(checkpoint, "_write", half)
    else:
        monkeypatch.setattr(checkpoint.os, step, full)
    with pytest.raises(CheckpointError, match=r"cannot write .*a\.pt: No space left on device; the last good file"):
        checkpoint.save(path, {"generation": 2})
    monkeypatch.undo()
    assert checkpoint.load(path) == {"generation": 1}
    assert [file.name for file in tmp_path.iterdir()] == ["a.pt"]


def test_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="cannot write"):
        checkpoint.save(tmp_path / "no" / "a.pt", {})
