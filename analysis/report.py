"""The report: one page that opens anywhere, the same in Markdown, and every table and figure as a file of its own.

``compose`` gathers the sections, ``write`` puts them into a folder that appears complete or not at all.
An empty store gives the skeleton: every table with the paper's numbers, every gap with the command that fills it.
"""

import base64
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis import (
    ablations,
    baselines,
    behaviour,
    cells,
    claims,
    commands,
    deployment,
    flown,
    lines,
    markup,
    paper,
    plates,
    sources,
    tables,
)
from analysis.cells import Cell, Table
from analysis.evidence import Evidence
from analysis.plates import Drawn, Gap
from analysis.sources import Sources


@dataclass(frozen=True)
class Section:
    """A heading with what stands below it, in reading order. ``commands`` measure what a drawn figure still lacks."""

    key: str
    title: str
    intro: str
    content: tuple[Table | Drawn, ...]
    commands: tuple[str, ...] = ()

    @property
    def measured(self) -> bool:
        """True when anything in it was measured by us."""
        return any(item.measured if isinstance(item, Table) else not isinstance(item, Gap) for item in self.content)


@dataclass(frozen=True)
class Report:
    """A composed report of one profile."""

    profile: str
    others: dict[str, str]  # profiles with data that this report does not show, and the commands that show it
    summary: tuple[str, ...]
    sections: tuple[Section, ...]
    sources: Sources
    fill: str  # the command that measures everything

    @property
    def main(self) -> Table:
        """The main table: of the paper's world, or of the first other world where only that was flown."""
        found = [item for item in self.sections[0].content if isinstance(item, Table) and item.key.startswith("main")]
        return next((table for table in found if table.measured), found[0])

    def tables(self) -> Iterator[Table]:
        """All tables, in reading order."""
        return (item for section in self.sections for item in section.content if isinstance(item, Table))

    def figures(self) -> "Iterator[Any]":
        """All figures that could be drawn (``analysis.figures.Plate``), in reading order."""
        for section in self.sections:
            yield from (item for item in section.content if not isinstance(item, Table | Gap))


def compose(evidence: Evidence) -> Report:
    """All sections of the report from one profile's evidence."""
    main = tables.main(evidence)
    beside = (ablations.compare(evidence), lines.table(evidence))
    store = evidence.store
    survey = commands.survey(evidence)
    sections = (
        Section(
            "main",
            "Main results",
            "The paper's Table I beside the same scene here. An episode counts as collision-free when no drone touched "
            "anything and all passed the goal line in time.",
            (*main, *filter(None, beside)),
        ),
        Section(
            "sweeps",
            "More obstacles",
            "Policies trained on 10 columns and 2 balls, flown unchanged among more and fewer. "
            "The paper gives these results as pictures only.",
            (*plates.sweeps(evidence, "columns"), *plates.sweeps(evidence, "balls")),
            (*plates.unswept(evidence, "columns"), *plates.unswept(evidence, "balls")),
        ),
        Section(
            "baselines",
            "Baselines",
            "What was flown under each name. A planner flies with the parameters of its public code and with a set "
            "that fits this task (fair); both are shown, and so is whatever departs from the published method.",
            tuple(baselines.tables(evidence)) or (Gap("baselines", "Parameter sets and deviations", (survey,)),),
        ),
        Section(
            "behaviour",
            "Behaviour",
            "The same episode flown by every method, in the two scenes of the paper's behaviour pictures.",
            tuple(behaviour.pictures(evidence)),
            behaviour.unrecorded(evidence),
        ),
        Section(
            "weights",
            "Reward weights",
            "Stage 1: one policy per random weight vector in the simplified task (3 balls, no columns), and the share "
            "of its episodes that satisfy all four objectives.",
            tuple(plates.weights(evidence)),
        ),
        Section(
            "ablations",
            "Ablations",
            "What the attention modules and the curriculum contribute, to be compared at equal training budgets.",
            (ablations.encoder(evidence), ablations.curriculum(evidence)),
        ),
        Section("learning", "Learning", "How the trainings went.", tuple(plates.learning(evidence))),
        Section(
            "deployment",
            "Deployment",
            "The paper's Table II rests on ten flights per cell. No drone was flown here: the scenes are simulated at "
            "500 Hz with noisy motion capture, a late and lossy radio, and craft that are not quite the model.",
            (deployment.table(evidence), *plates.robustness(evidence)),
        ),
        Section(
            "claims",
            "Claims",
            "What the paper claims, what was measured here, and what follows.",
            (claims.table(evidence),),
        ),
    )
    others = {name: commands.report(evidence, name) for name in store.profiles() if name != evidence.profile}
    fill = commands.everything(evidence) if not evidence.cells else survey
    summary = _summary(next((table for table in main if table.measured), main[0]), evidence)
    return Report(evidence.profile, others, summary, sections, sources.trace(evidence), fill)


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
        _fill(report, building)
        if record is not None:
            (building / "run.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        building.chmod(0o755)
        if folder.exists():
            shutil.rmtree(folder)
        os.replace(building, folder)
    finally:
        shutil.rmtree(building, ignore_errors=True)
    return folder


def _fill(report: Report, folder: Path) -> None:
    images: dict[str, str] = {}
    for name in ("tables", "figures"):
        (folder / name).mkdir()
    for table in report.tables():
        (folder / "tables" / f"{table.key}.tex").write_text(markup.latex(table), encoding="utf-8")
        if table.measured:
            text = f"# {table.stamp}\n" + table.numbers().to_csv(index=False)
            (folder / "tables" / f"{table.key}.csv").write_text(text, encoding="utf-8")
    for plate in report.figures():
        from analysis import figures

        for path in figures.write(plate, folder / "figures"):
            images[path.name] = base64.b64encode(path.read_bytes()).decode("ascii")
    (folder / "report.html").write_text(_render("report.html.j2", report, images), encoding="utf-8")
    (folder / "report.md").write_text(_render("report.md.j2", report, images), encoding="utf-8")


def _render(template: str, report: Report, images: Mapping[str, str]) -> str:
    import jinja2

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
        paper=paper,
        html=markup.html,
        markdown=markup.markdown,
        is_table=lambda item: isinstance(item, Table),
        is_gap=lambda item: isinstance(item, Gap),
    )


def _summary(main: Table, evidence: Evidence) -> tuple[str, ...]:
    """The result in a sentence for each full method, or for our best policy, from the main table's own cells."""
    keys = [column.key for column in main.columns]
    found = [dict(zip(keys, row, strict=True)) for row in main.rows]
    flown_ones = {cell["method"].text: cell for cell in found if cell["cfr"].value is not None}
    lines = []
    for name, cell in flown_ones.items():
        if name.startswith("Ours"):
            ours, theirs = _sentence(cell["cfr"], cell["fm"]), _sentence(cell["cfr_paper"], cell["fm_paper"])
            lines.append(f"{name}: {ours}. The paper: {theirs}.")
    if not evidence.cells:
        return (f"No episode has been flown under profile {evidence.profile} yet: what follows is the skeleton.",)
    if not lines:
        lines.append("The full method of the paper has not been flown in the main scene yet.")
        best, _ = flown.ours(evidence)
        if best is not None and (its := flown_ones.get(evidence.names[best.key])) is not None:
            published = paper.published("ours", "mixed")
            theirs = _sentence(cells.paper_rate(published), cells.paper_fm(published))
            world, ours = main.caption.partition(".")[0].lower(), _sentence(its["cfr"], its["fm"])
            beside = f" The paper's own method: {theirs}." if main.key == "main" else ""  # another world: no comparison
            lines.append(f"{evidence.names[best.key]}, {world}: {ours}.{beside}")
    return tuple(lines)


def _sentence(cfr: Cell, fm: Cell) -> str:
    """A result in words: CFR 0.914 [0.886, 0.944] (823/900), FM 0.163 m."""
    counted = f" ({cfr.details[-1]})" if cfr.details else ""
    between = f" {cfr.details[0]}" if len(cfr.details) > 1 else ""
    metres = f", FM {fm.text} m" if fm.value is not None else ", no FM"
    return f"CFR {cfr.text}{between}{counted}{metres}"
