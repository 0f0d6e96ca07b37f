"""The front page's results: a report's main table and one figure, put between two marks of a Markdown file."""

import shutil
from dataclasses import replace
from pathlib import Path

from analysis import markup
from analysis.cells import Table
from analysis.report import Report

BEGIN, END = "<!-- results: made by formctl report --readme, do not edit -->", "<!-- end of results -->"

SHOWN = ("method", "cfr", "cfr_paper", "fm", "fm_paper", "cfr_strict", "evidence")
"""Columns of the main table on the front page."""

FIGURES = ("sweep_columns", "sweep_balls", "behaviour_dynamic", "learning")
"""The first of these that could be drawn is shown."""


def write(report: Report, folder: Path, page: Path, images: Path) -> list[Path]:
    """Put the results of a report written to ``folder`` into ``page``, its figure into ``images``; what was written.

    Raises ValueError where the page has no place for them.
    """
    text = page.read_text(encoding="utf-8")
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"{page} has no place for results: write the lines '{BEGIN}' and '{END}' where they belong")
    written = [page]
    picture = ""
    for plate in sorted((p for p in report.figures() if p.key in FIGURES), key=lambda p: FIGURES.index(p.key)):
        images.mkdir(parents=True, exist_ok=True)
        target = images / f"{plate.key}.png"
        shutil.copyfile(folder / "figures" / target.name, target)
        written.append(target)
        place = target.resolve().relative_to(page.resolve().parent)
        picture = f"\n![{plate.title}]({place})\n\n{plate.title}: {plate.caption}\n"
        break
    page.write_text(f"{before}{BEGIN}\n\n{_table(report.main)}{picture}\n{END}{after}", encoding="utf-8")
    return written


def _table(main: Table) -> str:
    """The main table without its commands: whoever wants to fill it reads the report."""
    chosen = [place for place, column in enumerate(main.columns) if column.key in SHOWN]
    measured = [row for row in main.rows if any(cell.value is not None for cell in row)]
    columns = tuple(main.columns[place] for place in chosen)
    rows = tuple(tuple(row[place] for place in chosen) for row in measured)
    plain = tuple(tuple(replace(cell, command="") for cell in row) for row in rows)
    return markup.markdown(
        Table(main.key, main.title, main.caption, columns, plain, main.stamp, main.notes, main.groups)
    )
