"""Which episodes of an evaluation are recorded, and keeping them: ``formctl eval --record worst=5``."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from formctl.errors import ConfigError
from formctl.viewers.files import write_mcap

if TYPE_CHECKING:
    from analysis.recordings import Recording

KINDS = ("worst", "failed", "first", "ids")


@dataclass(frozen=True)
class RecordingSelection:
    """Some episodes of a run, by their row numbers or by how they went."""

    kind: str  # worst | failed | first | ids
    count: int
    ids: tuple[int, ...] = ()

    @staticmethod
    def parse(text: str) -> "RecordingSelection":
        """``worst=5``, ``failed=5``, ``first=3`` or ``ids=4,17``. Raises ConfigError."""
        kind, _, values = text.partition("=")
        numbers = values.split(",")
        usable = all(value.isdigit() for value in numbers) and (
            kind == "ids" or (len(numbers) == 1 and int(values) > 0)
        )
        if kind not in KINDS or not usable:
            raise ConfigError(f"--record {text} cannot be used: write worst=5, failed=5, first=3 or ids=4,17")
        ids = tuple(sorted({int(value) for value in numbers})) if kind == "ids" else ()
        return RecordingSelection(kind, len(ids) or int(values), ids)

    def check(self, episodes: int) -> None:
        """Raise ConfigError for an episode beyond those that will be flown."""
        beyond = [number for number in self.ids if number >= episodes]
        if beyond:
            raise ConfigError(f"--record ids={beyond[0]}: the episodes are 0 to {episodes - 1}")

    def candidates(self, first: int, last: int) -> list[int]:
        """Rows from ``first`` up to ``last`` that may turn out to be wanted."""
        if self.kind == "ids":
            return [number for number in self.ids if first <= number < last]
        return list(range(first, min(last, self.count))) if self.kind == "first" else list(range(first, last))

    def rank(self, row: dict[str, Any], number: int) -> tuple[float, ...] | None:
        """Place of an episode among the wanted ones, smallest first; None for one that is not wanted."""
        if self.kind == "failed":
            return None if row["cfr"] else (number,)
        if self.kind == "worst":
            return (*badness(row), number)
        return (number,)


def badness(row: dict[str, Any]) -> tuple[float, float]:
    """The worst first: collisions by how early, then late ones and the successful ones by their formation error."""
    contact = float(row["first_contact_time"])
    fm = float(row["fm"])
    if row["failure"] not in ("", "late") and math.isfinite(contact):
        return 0.0, contact
    return (2.0 if row["cfr"] else 1.0), -fm if math.isfinite(fm) else -math.inf


@dataclass
class TopRecordings:
    """Holds the recordings wanted so far; never more of them than asked for."""

    selection: RecordingSelection
    folder: Path
    ranked: list[tuple[tuple[float, ...], int, "Recording"]] = field(default_factory=list)

    def places(self, first: int, count: int) -> list[int]:
        """Places in a batch of ``count`` episodes, whose first is row ``first``, that have to be watched."""
        return [number - first for number in self.selection.candidates(first, first + count)]

    def offer(
        self, rows: dict[str, np.ndarray], first: int, make: "Callable[[int, dict[str, Any]], Recording]"
    ) -> None:
        """Look at the rows of a batch, whose first is row ``first`` of the run; ``make`` gives the record of one."""
        found = []
        for number in self.selection.candidates(first, first + len(rows["cfr"])):
            row = {key: values[number - first] for key, values in rows.items()}
            if (rank := self.selection.rank(row, number)) is not None:
                found.append((rank, number, row))
        for rank, number, row in sorted(found, key=lambda entry: entry[:2])[: self.selection.count]:
            if len(self.ranked) < self.selection.count or rank < self.ranked[-1][0]:
                self.ranked.append((rank, number, make(number - first, row)))
                self.ranked.sort(key=lambda entry: entry[0])
                del self.ranked[self.selection.count :]

    def write(self) -> list[Path]:
        """Write what is held as ``episode_NUMBER.mcap``; the paths in the order of their rank."""
        paths = []
        for _, number, recording in self.ranked:
            paths.append(self.folder / f"episode_{number}.mcap")
            write_mcap(recording, paths[-1])
        return paths
