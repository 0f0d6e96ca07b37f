"""The sections of a report, in reading order. An empty store gives the skeleton: the paper's numbers, and gaps."""

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from analysis.claims import verdicts
from analysis.data.evidence import Evidence
from analysis.data.provenance import Provenance, trace
from analysis.figures import report_figures
from analysis.figures.report_figures import MissingFigure
from analysis.figures.style import ReportFigure
from analysis.tables import ablations, baselines, deployment, goal_lines, main
from analysis.tables.table import Table

DEFAULT_STORE = Path("runs")
"""Where commands look and write without being told."""

Item: TypeAlias = Table | ReportFigure | MissingFigure


@dataclass(frozen=True)
class Section:
    """A heading with what stands below it, in reading order."""

    key: str
    title: str
    intro: str
    content: tuple[Item, ...]

    @property
    def measured(self) -> bool:
        """True when anything in it was measured by us."""
        return any(
            item.measured if isinstance(item, Table) else isinstance(item, ReportFigure) for item in self.content
        )


@dataclass(frozen=True)
class Report:
    """A composed report of one profile. ``main`` is the main table of the first world that was flown."""

    profile: str
    others: dict[str, str]  # profiles with data that this report does not show, and the commands that show it
    summary: tuple[str, ...]
    main: Table
    front: Table  # what of it goes on a front page
    satisfaction: str  # what counts in SR, in words; empty where no settings tell
    sections: tuple[Section, ...]
    provenance: Provenance
    fill: str  # one sentence with the command that measures what is missing; empty where nothing is

    def tables(self) -> Iterator[Table]:
        """All tables, in reading order."""
        return (item for section in self.sections for item in section.content if isinstance(item, Table))

    def figures(self) -> Iterator[ReportFigure]:
        """All figures that could be drawn, in reading order."""
        return (item for section in self.sections for item in section.content if isinstance(item, ReportFigure))


def compose(evidence: Evidence) -> Report:
    """All sections of the report from one profile's evidence."""
    mains = main.tables(evidence)
    first = next((table for table in mains if table.measured), mains[0])
    sections = (
        Section(
            "main",
            "Main results",
            "The paper's Table I beside the same scene here. An episode succeeds (CFR) when until the goal line no "
            "drone touched anything or left the flight corridor, and all passed that line in time.",
            (*mains, *filter(None, (ablations.paired_table(evidence), goal_lines.table(evidence)))),
        ),
        Section(
            "sweeps",
            "More obstacles",
            "Every method flown unchanged among fewer and more obstacles. The paper gives these results as pictures "
            "only.",
            (*report_figures.sweeps(evidence, "columns"), *report_figures.sweeps(evidence, "balls")),
        ),
        Section(
            "baselines",
            "Baselines",
            "What was flown under each name. A planner flies with the parameters of its public code and with a set "
            "that fits this task (fair); both are shown, and so is whatever departs from the published method.",
            tuple(baselines.tables(evidence)) or (MissingFigure("baselines", "Parameter sets and deviations"),),
        ),
        Section(
            "behaviour",
            "Behaviour",
            "The same episode flown by every method, in the two scenes of the paper's behaviour pictures.",
            tuple(report_figures.behaviour(evidence)),
        ),
        Section(
            "weights",
            "Reward weights",
            "Stage 1: one policy per random weight vector in the simplified task (3 balls, no columns), and the share "
            "of its episodes that satisfy all four objectives.",
            tuple(report_figures.weights(evidence)),
        ),
        Section(
            "ablations",
            "Ablations",
            "What the attention modules and the curriculum contribute, to be compared at equal training budgets.",
            (ablations.encoder(evidence), ablations.curriculum(evidence)),
        ),
        Section("learning", "Learning", "How the trainings went.", tuple(report_figures.learning(evidence))),
        Section(
            "deployment",
            "Deployment",
            "The paper's Table II rests on ten flights per cell. No drone was flown here: the scenes are simulated "
            "with noisy motion capture, a late and lossy radio, and craft that are not quite the model.",
            (deployment.table(evidence), *report_figures.robustness(evidence)),
        ),
        Section(
            "claims",
            "Claims",
            "What the paper claims, what was measured here, and what follows.",
            (verdicts.table(evidence),),
        ),
    )
    others = {name: _command(evidence, name) for name in evidence.store.profiles() if name != evidence.profile}
    summary, sources = main.summary(first, evidence), trace(evidence)
    front, counts = main.front_page(first, evidence), evidence.satisfaction(evidence.cells)
    fill = _fill(evidence, sections)
    return Report(evidence.profile, others, summary, first, front, counts, sections, sources, fill)


def _fill(evidence: Evidence, sections: tuple[Section, ...]) -> str:
    """What to type for everything that was not measured."""
    items = [item for section in sections for item in section.content]
    gaps = sum(item.gaps for item in items if isinstance(item, Table))
    missing = sum(isinstance(item, MissingFigure) for item in items)
    if not gaps and not missing:
        return ""
    root = evidence.store.root
    where = "" if root == DEFAULT_STORE else f" {shlex.quote(f'runs={root}')}"
    here = f"formctl reproduce survey=paper profile={evidence.profile}{where}"
    what = f"{gaps} cells and {missing} figures of this report are not measured"
    return f"{what}: '{here} --plan' lists the flights and trainings that are missing, without --plan it makes them."


def _command(evidence: Evidence, profile: str) -> str:
    """Another profile's report of the same store."""
    root = evidence.store.root
    elsewhere = "" if root == DEFAULT_STORE else f" --runs {shlex.quote(str(root))}"
    return f"formctl report --profile {profile}{elsewhere}"
