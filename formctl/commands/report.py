"""``formctl report``: the paper's tables and figures from whatever is in the store."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from analysis.report import Report

SHOWN = ("method", "cfr", "cfr_paper", "fm", "fm_paper", "sr", "evidence")
"""Columns of the main table that fit on a terminal; the report has them all."""

IN_FULL = ("cfr", "cfr_paper", "evidence")
"""Of those, the ones with interval and counts."""

MOST_WARNINGS = 5

IMAGES = Path("docs/images")
"""Where the figure of ``--readme`` goes, beside the file."""

POWERS = (0.8, 0.9)
COUNTS = (10, 25, 100, 1000)
"""Episodes of the paper's flights, planners and policies, and ours."""


def command(
    profile: Annotated[
        str | None, typer.Option(help="Show this profile; the most serious one with an evaluated policy otherwise.")
    ] = None,
    runs: Annotated[Path, typer.Option(help="The output store.")] = Path("runs"),
    out: Annotated[Path | None, typer.Option(help="Write to this folder instead of RUNS/report/PROFILE/ID.")] = None,
    readme: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Put the main table and a figure into this Markdown file.")
    ] = None,
    power: Annotated[
        str | None, typer.Option(metavar="RATE,RATE", help="Say how many episodes separate two rates, and stop.")
    ] = None,
) -> None:
    """The paper's tables and figures from whatever is in the store, the paper's numbers beside ours."""
    if power is not None:
        show_power(power)
        return
    written, report = build(runs, profile, out)
    show(report, written)
    if readme is not None:
        from analysis import showcase
        from formctl.console import say

        for path in showcase.write(report, written, readme, readme.parent / IMAGES):
            say(f"written: {path}")


def show_power(text: str) -> None:
    """Episodes that tell two rates apart, and what usual numbers of episodes can tell from the higher one.

    Raises ConfigError for anything but two rates.
    """
    from analysis import stats
    from formctl import console
    from formctl.errors import ConfigError

    try:
        low, high = sorted(float(part) for part in text.split(","))
        rows = [(f"{power:.0%}", f"{stats.episodes_to_separate(low, high, power):,}") for power in POWERS]
    except ValueError as error:
        raise ConfigError(f"--power {text}: write two different rates, e.g. --power 0.89,0.83 ({error})") from error
    console.table(("power", "episodes per method"), rows, title=f"to tell {low:g} from {high:g} (two-sided, 5 %)")
    lines = [(f"{count:,}", f"{stats.separable(high, count):.3f} or lower") for count in COUNTS]
    console.table(("episodes each", "told apart with 80 % power"), lines, title=f"what can be told from {high:g}")


def build(runs: Path, profile: str | None = None, out: Path | None = None, parents: tuple[str, ...] = ()) -> Any:
    """Write the report of a store; returns its folder and the ``analysis.report.Report``.

    Raises ValueError: an unknown profile, a store that is none, a folder ``out`` that holds something else.
    """
    from analysis import evidence, report, rows
    from envs.vocabulary import METRIC_VERSION
    from formctl import store
    from formctl.errors import ConfigError
    from formctl.settings.paths import choices
    from formctl.store import provenance

    found = rows.load(runs)
    known = sorted({*choices("profile"), *found.profiles()})
    if profile is not None and profile not in known:
        raise ConfigError(f"--profile {profile} is unknown; choose one of: {', '.join(known)}")
    gathered = evidence.gather(found, profile, baselines=choices("baseline"), metric_version=METRIC_VERSION)
    composed = report.compose(gathered)
    identifier, now = store.new_id(), store.now()
    record = {
        "schema": store.SCHEMA,
        "kind": "report",
        "name": composed.profile,
        "id": identifier,
        "status": "done",
        "profile": composed.profile,
        "seed": 0,
        "argv": provenance.argv(),
        "created": now,
        "started": now,
        "finished": now,
        "minutes": 0.0,
        "parents": [*parents, *(run.id for run in composed.sources.runs)],
        "provenance": provenance.collect(),
        "budget": {},
        "result": {"left_out": len(composed.sources.left_out)},
        "error": None,
    }
    folder = out or runs / "report" / composed.profile / identifier
    return report.write(composed, folder, record), composed


def show(report: "Report", folder: Path) -> None:
    """Print the main table, what would fill it, what was left out, and where the report is."""
    from formctl import console

    table = report.main
    columns = [(index, column) for index, column in enumerate(table.columns) if column.key in SHOWN]
    lines = [
        [row[index].plain() if column.key in IN_FULL else row[index].text for index, column in columns]
        for row in table.rows
    ]
    console.table([column.title for _, column in columns], lines, title=f"{table.title} ({table.stamp})")
    for line in report.summary:
        console.say(line)
    if table.commands:
        console.say("to fill what was not measured:")
        for fill in table.commands:
            console.say(f"  {fill}")
        console.say(f"everything at once: {report.fill}")
    for line in report.sources.left_out[:MOST_WARNINGS]:
        console.warn(line)
    if len(report.sources.left_out) > MOST_WARNINGS:
        console.warn(f"{len(report.sources.left_out) - MOST_WARNINGS} more; all are listed under Provenance")
    console.say(f"report: {folder / 'report.html'}")
