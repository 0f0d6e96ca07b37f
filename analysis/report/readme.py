"""The front page's results: a report's main table and one figure, put between two marks of a Markdown file."""

import shutil
from pathlib import Path

from analysis.report.compose import Report
from analysis.tables import render

BEGIN, END = "<!-- results: made by formctl report --readme, do not edit -->", "<!-- end of results -->"

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
    drawn = {figure.key: figure for figure in report.figures()}
    if figure := next((drawn[key] for key in FIGURES if key in drawn), None):
        images.mkdir(parents=True, exist_ok=True)
        target = images / f"{figure.key}.png"
        shutil.copyfile(folder / "figures" / target.name, target)
        written.append(target)
        place = target.resolve().relative_to(page.resolve().parent)
        picture = f"\n![{figure.title}]({place})\n\n{figure.title}: {figure.caption}\n"
    table = render.markdown(report.front)
    page.write_text(f"{before}{BEGIN}\n\n{table}{picture}\n{END}{after}", encoding="utf-8")
    return written
