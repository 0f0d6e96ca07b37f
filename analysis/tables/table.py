"""A table before it is set in type: cells that know their number, their small print, and whether they were measured."""

from dataclasses import dataclass, field
from typing import NamedTuple

import pandas as pd

from analysis import stats
from analysis.data.evidence import Stamp
from analysis.data.methods import Method
from analysis.data.published import Published
from analysis.data.text import short
from analysis.stats import Mean, Rate

NOT_MEASURED = "not measured"
NOTHING = "–"  # a cell that cannot have a number, such as the paper's for an agent it does not mention

INTERVALS = "Square brackets: 95 % intervals (Wilson; with several seeds two-level bootstrap over seeds and episodes)."

A_POINT = 0.01
"""Difference from which a cell also says the rate without the corridor."""


@dataclass(frozen=True)
class Cell:
    """One cell."""

    text: str
    details: tuple[str, ...] = ()  # small print, line by line: interval, counts
    value: float | None = None
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
    def gaps(self) -> int:
        """Cells that nobody measured."""
        return sum(cell.missing for row in self.rows for cell in row)

    def frame(self) -> pd.DataFrame:
        """The table as text, one row per line: what a reader sees."""
        titles = [column.title for column in self.columns]
        return pd.DataFrame([[cell.plain() for cell in row] for row in self.rows], columns=titles)

    def numbers(self) -> pd.DataFrame:
        """The table in full precision: numbers where there are numbers, NaN where nothing was measured."""
        records = [
            {c.key: cell.text if c.left else cell.value for c, cell in zip(self.columns, row, strict=True)}
            for row in self.rows
        ]
        frame = pd.DataFrame(records, columns=[c.key for c in self.columns])
        return frame.astype({c.key: "float64" for c in self.columns if not c.left})


MISSING = Cell(NOT_MEASURED)


def rate_cell(rate: Rate) -> Cell:
    """A share of episodes: 0.893 with [interval] and k/n."""
    return Cell(f"{rate.value:.3f}", (interval(rate.low, rate.high), f"{rate.k}/{rate.n}"), rate.value)


def flag_cell(rows: pd.DataFrame, flag: str) -> Cell:
    """The share of a cell's episodes whose flag is set."""
    return rate_cell(stats.rate_of(rows, flag))


def success_cell(rows: pd.DataFrame) -> Cell:
    """CFR; where flights outside the corridor would change it by more than a point, the rate with them as well."""
    cell = flag_cell(rows, "cfr")
    if "cfr_any_path" not in rows:
        return cell
    anywhere = float(rows["cfr_any_path"].mean())
    if anywhere - float(rows["cfr"].mean()) <= A_POINT + 1e-9:
        return cell
    return Cell(cell.text, (*cell.details, f"{anywhere:.3f} outside too"), cell.value)


def fm_cell(rows: pd.DataFrame) -> Cell:
    """FM (m) over the successful episodes."""
    return mean_cell(stats.fm_of(rows))


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


def paper_rate(cell: Published | None) -> Cell:
    """The paper's rate with the Wilson interval of its episode count; a dash where it gives none."""
    if cell is None:
        return Cell(NOTHING, paper=True)
    limits = interval(*stats.wilson(cell.successes, cell.episodes), digits=2)
    return Cell(f"{cell.cfr:.2f}", (limits, f"{cell.successes}/{cell.episodes}"), cell.cfr, paper=True)


def paper_fm(cell: Published | None) -> Cell:
    """The paper's FM (m) with the number of successful episodes it rests on; a dash where it gives none."""
    if cell is None or cell.fm is None:
        return Cell(NOTHING, paper=True)
    return Cell(f"{cell.fm:.3f}", (f"n = {cell.successes}",), cell.fm, paper=True)


def evidence_cell(method: Method, rows: pd.DataFrame) -> Cell:
    """What a row rests on: episodes and, of a learnt method, seeds, training steps, reward, weights, observation."""
    episodes = f"{len(rows):,} episodes"
    if not method.facts.learnt:
        return Cell(episodes)
    seeds, published = rows["train_seed"].nunique(), method.facts.published_steps
    share = f" of {short(published)} published" if published else ""
    budget = f"{short(method.facts.steps)} steps{share}"
    return Cell(episodes, ("one seed" if seeds == 1 else f"{seeds} seeds", budget, *method.trained))


def interval(low: float, high: float, digits: int = 3) -> str:
    """[low, high]."""
    return f"[{low:.{digits}f}, {high:.{digits}f}]"


def signed(value: float) -> str:
    """A difference with its sign, a true minus for negative ones."""
    return f"{value:+.3f}".replace("-", "−")


def p_text(p: float) -> str:
    """A p value."""
    return "< 0.001" if p < 0.001 else f"{p:.3f}"
