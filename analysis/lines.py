"""The main scene judged at other goal lines: rows keep when the last drone passed each, so nothing is flown again.

The goal line is where the obstacle field ends; the paper names none, and that of its release lies at 40 m, as far as
20 s at v* lead.
"""

from typing import TYPE_CHECKING

from analysis.cells import Cell, Column, Table
from analysis.evidence import Evidence
from analysis.tables import INTERVALS, headline_place, on_what, rate, seed_notes

if TYPE_CHECKING:
    import pandas as pd

_TIME = "time_y"
"""Columns that say in s when the last drone passed a line: ``time_y32_4`` for y = 32.4 m."""


def table(evidence: Evidence) -> Table | None:
    """CFR of every method at each line, within the headline's time limit; None where no rows tell."""
    where = headline_place(evidence)
    flown = {m: r for m in evidence.expected if where and (r := evidence.rows(m, where)) is not None}
    named = {str(column) for rows in flown.values() for column in rows}
    lines = sorted((column for column in named if column.startswith(_TIME)), key=place)
    if where is None or not lines:
        return None
    shown = {method: rows for method, rows in flown.items() if set(lines) <= set(rows)}
    columns = (
        Column("method", "Method", left=True, wide=0.16),
        *(Column(line, f"CFR, y = {place(line):g} m") for line in lines),
        Column("evidence", "Evidence", left=True),
    )
    body = tuple(
        (
            Cell(evidence.names[method.key]),
            *(rate(rows.assign(won=won(evidence, rows, line)), "won") for line in lines),
            on_what(method, rows),
        )
        for method, rows in shown.items()
    )
    caption = (
        f"Flights of the main table, won once every drone has passed y, in time and without a collision. {INTERVALS}"
    )
    used = [(method.key, where) for method in shown]
    return Table("lines", "Other goal lines", caption, columns, body, evidence.stamp(used), seed_notes(evidence, used))


def place(line: str) -> float:
    """Where a line lies, y in m, from the name of its column."""
    return float(line.removeprefix(_TIME).replace("_", "."))


def won(evidence: Evidence, rows: "pd.DataFrame", line: str) -> "pd.Series[bool]":
    """Episodes in which all drones passed the line of that column in time, and nothing was touched before."""
    limits = {run: evidence.store.run(run).config["eval"]["time_limit"] for run in rows["eval_run"].unique()}
    passed = rows[line] <= rows["eval_run"].map(limits).astype(float) + 1e-6
    return passed & ~(rows["first_contact_time"] <= rows[line])
