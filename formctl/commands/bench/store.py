"""``formctl bench store``: what the search's store costs per trial event, and until a large study has answered."""

from dataclasses import asdict
from typing import Annotated

import typer

from formctl.commands.options import Overrides, configs


def store(
    overrides: Overrides = None,
    trials: Annotated[int, typer.Option(min=1, help="Trials that the study has already.")] = 10_000,
    events: Annotated[int, typer.Option(min=1, help="Events of each kind that are timed.")] = 100,
) -> None:
    """What the search's store costs on SQLite: milliseconds per trial event, seconds per --status."""
    from formctl import console
    from formctl.store import provenance

    (config,) = configs(overrides)
    from formctl.search import costs

    run = provenance.new_run(config, "bench", "store")
    study = provenance.new_run(config, "search", "store", folder=run.path / "runs" / "search" / "store" / "study")
    console.say(f"about to fill a study with {trials:,} trials and time {events} events of each kind in {run.path}")
    with run.work() as live:
        lines = [*costs.measure(study.path, trials, events), costs.status(study, trials)]
        live.update(result={"costs": [asdict(line) for line in lines]})
    cells = []
    for line in lines:
        figures = (line.milliseconds, line.worst, line.processor)
        cells.append((line.event, f"{line.trials:,}", line.times, *(f"{figure:.1f}" for figure in figures)))
    console.table(("event", "trials in the study", "times", "ms each", "95 % under", "of it processor"), cells)
