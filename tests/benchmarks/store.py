"""What the search's store costs: milliseconds per trial event and seconds per --status of a large study.

python -m tests.benchmarks.store --trials 10000
"""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from formctl.console import table
from formctl.search import costs
from formctl.settings import compose
from formctl.store import provenance


def main(
    trials: Annotated[int, typer.Option(min=1, help="Trials that the study has already.")] = 10_000,
    events: Annotated[int, typer.Option(min=1, help="Events of each kind that are timed.")] = 100,
) -> None:
    """Fill a study on SQLite in a temporary folder and time it."""
    with tempfile.TemporaryDirectory() as folder:
        config = compose([f"runs={folder}"])
        study = provenance.new_run(config, "search", "store", folder=Path(folder) / "search" / "store" / "study")
        lines = [*costs.measure(study.path, trials, events), costs.status(study, trials)]
    cells = []
    for line in lines:
        figures = (line.milliseconds, line.worst, line.processor)
        cells.append((line.event, f"{line.trials:,}", line.times, *(f"{figure:.1f}" for figure in figures)))
    table(("event", "trials in the study", "times", "ms each", "95 % under", "of it processor"), cells)


if __name__ == "__main__":
    typer.run(main)
