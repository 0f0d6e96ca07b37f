"""A table before it is set in type: cells that know their number, their small print, and whether they were measured."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from analysis.evidence import Stamp
from analysis.paper import Published
from analysis.stats import Mean, Rate

if TYPE_CHECKING:
    import pandas as pd

NOT_MEASURED = "not measured"
NOTHING = "–"  # a cell that cannot have a number, such as the paper's for an agent it does not mention


@dataclass(frozen=True)
class Cell:
    """One cell."""

    text: str
    details: tuple[str, ...] = ()  # small print, line by line: interval, counts
    value: float | None = None
    command: str = ""  # of a missing cell, where there is one
    paper: bool = False  # a published number, set apart from ours

    @property
    def missing(self) -> bool:
        """True where nobody measured."""
        return self.text == NOT_MEASURED

    def plain(self) -> str:
        """Text and small print on one line."""
        return " ".join((self.text, *self.details))


class Column(NamedTuple):
    """A column's key (for data frames) and its heading."""

    key: str
    title: str
    left: bool = False  # set flush left: names and words
    wide: float = 0.0  # share of the page's width that sentences are broken at; 0: never broken


@dataclass(frozen=True)
class Table:
    """A table: headings, rows of cells, and what has to stand below it."""

    key: str  # file name
    title: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    stamp: Stamp
    notes: tuple[str, ...] = ()
    groups: tuple[int, ...] = field(default=())  # rows that begin a new group

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.key}: a row has {len(row)} cells for {len(self.columns)} columns")

    @property
    def measured(self) -> bool:
        """True when at least one cell is a measurement of ours."""
        return any(cell.value is not None and not cell.paper for row in self.rows for cell in row)

    @property
    def commands(self) -> tuple[str, ...]:
        """Commands that fill the missing cells, each once, in reading order."""
        return tuple(dict.fromkeys(cell.command for row in self.rows for cell in row if cell.command))

    def mark(self, cell: Cell) -> str:
        """Number of a cell's command in the list below the table, counted from 1; empty without one."""
        return str(self.commands.index(cell.command) + 1) if cell.command else ""

    def frame(self) -> "pd.DataFrame":
        """The table as text, one row per line: what a reader sees."""
        import pandas as pd

        return pd.DataFrame(
            [[cell.plain() for cell in row] for row in self.rows], columns=[c.title for c in self.columns]
        )

    def numbers(self) -> "pd.DataFrame":
        """The table in full precision: numbers where there are numbers, NaN where nothing was measured."""
        import pandas as pd

        records = [
            {c.key: cell.text if c.left else cell.value for c, cell in zip(self.columns, row, strict=True)}
            for row in self.rows
        ]
        frame = pd.DataFrame(records, columns=[c.key for c in self.columns])
        return frame.astype({c.key: "float64" for c in self.columns if not c.left})


def rate_cell(rate: Rate) -> Cell:
    """A share of episodes: 0.893 with [interval] and k/n."""
    return Cell(f"{rate.value:.3f}", (interval(rate.low, rate.high), f"{rate.k}/{rate.n}"), rate.value)


def mean_cell(mean: Mean | None) -> Cell:
    """A mean with [interval] (of one episode: none) and n; a dash where no episode counts (no success, so no FM)."""
    if mean is None:
        return Cell(NOTHING, ("no episode",))
    shown = (interval(mean.low, mean.high),) if mean.n > 1 else ()
    return Cell(f"{mean.value:.3f}", (*shown, f"n = {mean.n}"), mean.value)


def difference_cell(mean: Mean | None) -> Cell:
    """A difference with its sign."""
    if mean is None:
        return Cell(NOTHING, ("no episode",))
    over = f"n = {mean.n}" + (f", {mean.seeds} seeds" if mean.seeds > 1 else "")
    shown = (f"[{signed(mean.low)}, {signed(mean.high)}]",) if mean.n > 1 else ()
    return Cell(signed(mean.value), (*shown, over), mean.value)


def missing_cell(command: str) -> Cell:
    """A cell nobody measured, with the command that fills it; empty where nothing here can."""
    return Cell(NOT_MEASURED, command=command)


def paper_rate(cell: Published | None) -> Cell:
    """The paper's rate with the Wilson interval of its episode count; a dash where it gives none."""
    if cell is None:
        return Cell(NOTHING, paper=True)
    counts = f"{cell.successes}/{cell.episodes}"
    return Cell(f"{cell.cfr:.2f}", (interval(*cell.interval, digits=2), counts), cell.cfr, paper=True)


def paper_fm(cell: Published | None) -> Cell:
    """The paper's FM (m) with the number of successful episodes it rests on; a dash where it gives none."""
    if cell is None or cell.fm is None:
        return Cell(NOTHING, paper=True)
    return Cell(f"{cell.fm:.3f}", (f"n = {cell.successes}",), cell.fm, paper=True)


def interval(low: float, high: float, digits: int = 3) -> str:
    """[low, high]."""
    return f"[{low:.{digits}f}, {high:.{digits}f}]"


def signed(value: float) -> str:
    """A difference with its sign, a true minus for negative ones."""
    return f"{value:+.3f}".replace("-", "−")
