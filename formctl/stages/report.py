"""The paper's tables and figures from whatever is in the store: what ``formctl report`` does."""

from pathlib import Path

from analysis import report, stats
from analysis.data import evidence, rows
from analysis.report import readme as front_page
from envs.vocabulary import METRIC_VERSION
from formctl import console, store
from formctl.errors import ConfigError
from formctl.settings import choices
from formctl.store import provenance

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


def write_report(
    runs: Path = Path("runs"), *, profile: str | None = None, out: Path | None = None, readme: Path | None = None
) -> Path:
    """Write the report of a store, say what it shows, and return its folder.

    ``readme`` is a Markdown file that gets the main table and a figure. Raises ValueError.
    """
    folder, written = build(runs, profile, out)
    show(written, folder)
    if readme is not None:
        for path in front_page.write(written, folder, readme, readme.parent / IMAGES):
            console.say(f"written: {path}")
    return folder


def show_power(text: str) -> None:
    """Episodes that tell two rates apart, and what usual numbers of episodes can tell from the higher one.

    Raises ConfigError for anything but two rates.
    """
    try:
        low, high = sorted(float(part) for part in text.split(","))
        rows = [(f"{power:.0%}", f"{stats.episodes_to_separate(low, high, power):,}") for power in POWERS]
    except ValueError as error:
        raise ConfigError(f"--power {text}: write two different rates, e.g. --power 0.89,0.83 ({error})") from error
    console.table(("power", "episodes per method"), rows, title=f"to tell {low:g} from {high:g} (two-sided, 5 %)")
    lines = [(f"{count:,}", f"{stats.separable(high, count):.3f} or lower") for count in COUNTS]
    console.table(("episodes each", "told apart with 80 % power"), lines, title=f"what can be told from {high:g}")


def build(
    runs: Path, profile: str | None = None, out: Path | None = None, parents: tuple[str, ...] = ()
) -> tuple[Path, report.Report]:
    """Write the report of a store; returns its folder and the ``analysis.report.Report``.

    Raises ValueError: an unknown profile, a store that is none, a folder ``out`` that holds something else.
    """
    store_rows = rows.load(runs)
    known = sorted({*choices("profile"), *store_rows.profiles()})
    if profile is not None and profile not in known:
        raise ConfigError(f"--profile {profile} is unknown; choose one of: {', '.join(known)}")
    gathered = evidence.gather(store_rows, profile, metric_version=METRIC_VERSION)
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
        "parents": [*parents, *(run.id for run in composed.provenance.runs)],
        "provenance": provenance.collect(),
        "budget": {},
        "result": {"left_out": len(composed.provenance.left_out)},
        "error": None,
    }
    folder = out or runs / "report" / composed.profile / identifier
    return report.write(composed, folder, record), composed


def show(written: report.Report, folder: Path) -> None:
    """Print the main table, what would fill it, what was left out, and where the report is."""
    table = written.main
    columns = [(index, column) for index, column in enumerate(table.columns) if column.key in SHOWN]
    lines = [
        [row[index].plain() if column.key in IN_FULL else row[index].text for index, column in columns]
        for row in table.rows
    ]
    console.table([column.title for _, column in columns], lines, title=f"{table.title} ({table.stamp})")
    for line in (*written.summary, *filter(None, (written.satisfaction, written.fill))):
        console.say(line)
    for line in written.provenance.left_out[:MOST_WARNINGS]:
        console.warn(line)
    if len(written.provenance.left_out) > MOST_WARNINGS:
        console.warn(f"{len(written.provenance.left_out) - MOST_WARNINGS} more; all are listed under Provenance")
    console.say(f"report: {folder / 'report.html'}")
