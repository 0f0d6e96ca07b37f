"""The main scene judged at other goal lines: rows keep when the last drone passed each, so nothing is flown again.

The goal line is where the obstacle field ends; the paper names none, and that of its release lies at 40 m, as far as
20 s at v* lead.
"""

import pandas as pd

from analysis.data import lookup
from analysis.data.evidence import Evidence
from analysis.tables.notes import notes
from analysis.tables.table import INTERVALS, NOTHING, Cell, Column, Table, evidence_cell, flag_cell

_TIME = "time_y"
"""Columns that say in s when the last drone passed a line: ``time_y32_4`` for y = 32.4 m."""


def table(evidence: Evidence) -> Table | None:
    """CFR of every method at each line, within the headline's time limit; None where no rows tell."""
    where = lookup.main_place(evidence)
    flown = {m: r for m in evidence.expected if where and (r := evidence.rows(m, where)) is not None}
    lines = sorted({str(name) for rows in flown.values() for name in rows if str(name).startswith(_TIME)}, key=place)
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
            *(_cell(evidence, rows, line, lines) for line in lines),
            evidence_cell(method, rows),
        )
        for method, rows in shown.items()
    )
    caption = (
        "Flights of the main table, won once every drone has passed y, in time, inside the corridor and without a "
        "collision. A dash: the method ends its flights before that line, which lies beyond its destination. "
        f"{INTERVALS}"
    )
    used = [(method.key, where) for method in shown]
    return Table("lines", "Other goal lines", caption, columns, body, evidence.stamp(used), notes(evidence, used))


def place(line: str) -> float:
    """Where a line lies, y in m, from the name of its column."""
    return float(line.removeprefix(_TIME).replace("_", "."))


def won(evidence: Evidence, rows: pd.DataFrame, line: str) -> pd.Series:
    """Episodes in which all drones passed the line of that column in time, and nothing was touched or left before."""
    limits = {run: evidence.store.run(str(run)).config["eval"]["time_limit"] for run in rows["eval_run"].unique()}
    passed = rows[line] <= rows["eval_run"].astype(str).map(limits).astype(float) + 1e-6
    inside = rows["failure"].astype(str) != "corridor"
    return passed & inside & ~(rows["first_contact_time"] <= rows[line])


def _cell(evidence: Evidence, rows: pd.DataFrame, line: str, lines: list[str]) -> Cell:
    """A rate; a dash at a line that no flight has passed although the one before was passed."""
    before = lines[max(lines.index(line) - 1, 0)]
    if rows[line].isna().all() and rows[before].notna().any():
        return Cell(NOTHING, ("stops before",))
    return flag_cell(rows.assign(won=won(evidence, rows, line)), "won")
