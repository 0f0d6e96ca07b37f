"""Scenario banks: episodes frozen to a file, so that every method meets the very same ones."""

import hashlib
import io
import json
import os
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from envs import scenarios as drawing
from envs.spec import Scenarios, ScenarioSpec

FORMAT = "formctl-bank-1"

LATER = {"vehicle": "vehicle", "wind": "air", "delays": "messages"}
"""Fields that banks of before do not hold, and the parts of the scenario that draw them.

Where nothing was drawn both stay out of the digest: the same episodes keep their name.
"""


class BankError(ValueError):
    """A bank that cannot be used, with the reason and what to do."""


@dataclass(frozen=True)
class Bank:
    """Drawn episodes, the scenario they were drawn from and a digest of both."""

    spec: dict[str, Any]  # ScenarioSpec as plain data
    seed: int
    scenarios: Scenarios  # float64, whose values are float32's
    sha256: str

    @staticmethod
    def create(spec: ScenarioSpec, episodes: int, seed: int) -> "Bank":
        """Draw ``episodes`` of ``spec`` from ``seed``. ValueError if the columns do not fit the layout."""
        if episodes < 1:
            raise BankError(f"a bank needs at least one episode, not {episodes}")
        drawn = drawing.sample(spec, episodes, seed, dtype=torch.float64)
        plain = json.loads(json.dumps(asdict(spec)))
        return Bank(plain, seed, drawn, _digest(plain, seed, drawn))

    def __len__(self) -> int:
        return len(self.scenarios.id)

    def save(self, path: Path | str) -> None:
        """Write the bank as npz without pickle: atomically, over whatever was there."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        header = json.dumps({"format": FORMAT, "spec": self.spec, "seed": self.seed, "sha256": self.sha256})
        arrays = {name: field.numpy() for name, field in _held(self.scenarios)}
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
            try:
                np.savez_compressed(file, header=np.array(header), **arrays)
                file.flush()
                os.fsync(file.fileno())
            except BaseException:
                os.unlink(file.name)
                raise
        os.replace(file.name, path)

    @staticmethod
    def load(path: Path | str) -> "Bank":
        """Read a bank. BankError if it is missing, is not a bank, is damaged, or differs from its digest."""
        try:
            with np.load(io.BytesIO(Path(path).read_bytes()), allow_pickle=False) as archive:
                header = json.loads(str(archive["header"]))
                held = {name: torch.from_numpy(archive[name]) for name in Scenarios._fields if name in archive}
                scenarios = Scenarios(**(_nothing(held["position"]) | held))
        except FileNotFoundError:
            raise BankError(f"no bank at {path}: make one with 'formctl bank create --out {path}'") from None
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zipfile.LargeZipFile) as error:
            raise BankError(f"{path} is not a scenario bank, or is damaged ({type(error).__name__})") from None
        if header.get("format") != FORMAT:
            raise BankError(f"{path} is a bank of format '{header.get('format')}', this version reads '{FORMAT}'")
        bank = Bank(header["spec"], header["seed"], scenarios, header["sha256"])
        actual = _digest(bank.spec, bank.seed, bank.scenarios)
        if actual != bank.sha256:
            raise BankError(
                f"{path} does not match its own hash ({actual[:12]} is not {bank.sha256[:12]}): it was changed"
            )
        return bank


def _digest(spec: dict[str, Any], seed: int, scenarios: Scenarios) -> str:
    held = dict(_held(scenarios))
    idle = {part for field, part in LATER.items() if field not in held and not spec.get(part, {}).get("ground_effect")}
    law = {key: value for key, value in spec.items() if key not in idle}
    digest = hashlib.sha256(json.dumps({"spec": law, "seed": seed}, sort_keys=True).encode())
    for name, field in held.items():
        array = np.ascontiguousarray(field.numpy())
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _held(scenarios: Scenarios) -> Iterator[tuple[str, torch.Tensor]]:
    """The fields of a bank by name: all but the later ones of which nothing was drawn."""
    for name, field in scenarios._asdict().items():
        if name not in LATER or field.numel():
            yield name, field


def _nothing(position: torch.Tensor) -> dict[str, torch.Tensor]:
    """The later fields of episodes that start at ``position`` (E, N, 3), with nothing drawn."""
    episodes, drones = position.shape[:2]
    shapes = ((episodes, drones, 0), (episodes, 0, 7), (episodes, drones, drones, 0))
    return {name: position.new_zeros(shape) for name, shape in zip(LATER, shapes, strict=True)}
