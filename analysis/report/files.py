"""The report as files: one page that opens anywhere, the same in Markdown, every table and figure on its own."""

import base64
import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2

from analysis.data import published
from analysis.figures import style
from analysis.figures.report_figures import MissingFigure
from analysis.report.compose import Report
from analysis.tables import render
from analysis.tables.table import Table


def write(report: Report, folder: Path, record: Mapping[str, Any] | None = None) -> Path:
    """Write ``report.html``, ``report.md``, ``tables/`` and ``figures/`` to ``folder``; returns it.

    Built beside its place and renamed, so a reader never sees half a report. ``record`` becomes ``run.json``.
    Raises ValueError when ``folder`` holds anything but an earlier report.
    """
    if folder.exists() and any(folder.iterdir()) and not (folder / "report.html").is_file():
        raise ValueError(f"{folder} is not empty and holds no report; give --out another folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    building = Path(tempfile.mkdtemp(prefix=".building-", dir=folder.parent))
    try:
        _files(report, building)
        if record is not None:
            (building / "run.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        building.chmod(0o755)
        if folder.exists():
            shutil.rmtree(folder)
        os.replace(building, folder)
    finally:
        shutil.rmtree(building, ignore_errors=True)
    return folder


def _files(report: Report, folder: Path) -> None:
    images: dict[str, str] = {}
    for name in ("tables", "figures"):
        (folder / name).mkdir()
    for table in report.tables():
        (folder / "tables" / f"{table.key}.tex").write_text(render.latex(table), encoding="utf-8")
        if table.measured:
            text = f"# {table.stamp}\n" + table.numbers().to_csv(index=False)
            (folder / "tables" / f"{table.key}.csv").write_text(text, encoding="utf-8")
    for figure in report.figures():
        for path in style.write(figure, folder / "figures"):
            images[path.name] = base64.b64encode(path.read_bytes()).decode("ascii")
    (folder / "report.html").write_text(_page("report.html.j2", report, images), encoding="utf-8")
    (folder / "report.md").write_text(_page("report.md.j2", report, images), encoding="utf-8")


def _page(template: str, report: Report, images: Mapping[str, str]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=template.endswith(".html.j2"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(
        report=report,
        images=images,
        paper=published,
        html=render.html,
        markdown=render.markdown,
        is_table=lambda item: isinstance(item, Table),
        is_gap=lambda item: isinstance(item, MissingFigure),
    )
