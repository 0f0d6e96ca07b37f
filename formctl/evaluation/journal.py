"""Episodes kept as they land, for methods that fly them one at a time.

Every finished episode is a line of ``flown.jsonl`` in the run's folder until the table of all of them is written: an
evaluation that was killed goes on with the episodes that are missing.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import pandas as pd

from envs.spec import Scenarios
from formctl.store.files import append_line, plain, read_lines


@dataclass(frozen=True)
class EpisodeJournal:
    """Rows of episodes that are flown already, by number; without a path nothing is kept."""

    path: Path | None

    def read(self) -> dict[int, dict[str, Any]]:
        """Rows by number of the episode."""
        return {} if self.path is None else {line["flight"]: line["row"] for line in read_lines(self.path)}

    def add(self, number: int, row: dict[str, Any]) -> dict[str, Any]:
        """Keep a row; returns it as it will be read back."""
        row = plain(row)
        if self.path is not None:
            append_line(self.path, {"flight": number, "row": row})
        return row

    def remove(self) -> None:
        """The rows stand elsewhere now."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def groups(episodes: Sequence[Scenarios], numbers: Sequence[int], size: int) -> Iterator[list[int]]:
    """``numbers`` of episodes, at most ``size`` at a time, those together that are of the same shape."""
    for _, alike in groupby(numbers, key=lambda number: [field.shape for field in episodes[number]]):
        same = list(alike)
        yield from (same[first : first + size] for first in range(0, len(same), size))


def table(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """Rows of JSON types as columns; only numbers that are not finite are null."""
    missing = float("nan")
    return pd.DataFrame([{name: missing if value is None else value for name, value in row.items()} for row in rows])
