"""``formctl bench pilot``: how short a search trial may be and still rank weight vectors."""

import json
from typing import TYPE_CHECKING, Annotated

import typer

from formctl.commands.options import Overrides, configs

if TYPE_CHECKING:
    import pandas as pd

    from formctl.settings import Config
    from formctl.store import Run

BUDGETS = (100_000, 200_000, 400_000, 800_000)
"""Steps per trial where the call names none."""


def pilot(
    overrides: Overrides = None,
    trials: Annotated[int, typer.Option(min=3, help="Weight vectors, the same at every budget.")] = 8,
    budget: Annotated[
        list[int] | None,
        typer.Option(min=1, help="Steps per trial; to be repeated. Default 100,000 200,000 400,000 800,000."),
    ] = None,
) -> None:
    """Search with the same weight vectors at several budgets, and tell how well short trials rank them."""
    from formctl import console
    from formctl.search import beginning
    from formctl.store import provenance

    plan = studies(overrides or [], trials, sorted(set(budget or BUDGETS)))
    runs = [beginning.execute(config, config.name)[0] for config in plan]
    bench = provenance.new_run(plan[0], "bench", "pilot", parents=tuple(run.id for run in runs))
    with bench.work() as live:
        ranks = write(live, runs)
    cells = [
        (
            f"{row.budget:,}",
            f"{row.minutes:.1f}",
            f"{row.spearman:.2f}",
            f"{row.kendall:.2f} (p {row.p:.2g})",
            f"{row.winner}: {row.winner_sr_longest:.3f} of {row.best_sr_longest:.3f}",
        )
        for row in ranks.itertuples()
    ]
    columns = ("steps per trial", "minutes", "Spearman", "Kendall", "winner here: its SR at the longest, of the best")
    console.table(columns, cells, title=f"{trials} weight vectors; ranks of SR against those at the longest budget")
    for name in ("trials.csv", "ranks.csv", "pilot.png"):
        console.say(f"written: {bench.path / name}")


def studies(overrides: list[str], trials: int, budgets: list[int]) -> "list[Config]":
    """One study per budget, alike in all but it. Raises ValueError for a single budget."""
    if len(budgets) < 2:
        raise ValueError("a pilot compares budgets: name two or more with --budget")
    found = []
    for steps in budgets:
        (config,) = configs([*overrides, f"search.trials={trials}", f"search.steps={steps}", f"name=pilot_{steps}"])
        found.append(config)
    return found


def write(live: "Run", runs: "list[Run]") -> "pd.DataFrame":
    """``trials.csv``, ``ranks.csv`` and ``pilot.png`` in the run's folder; returns the ranks."""
    import pandas as pd

    from analysis import pilot as analysis
    from analysis.figures import pilot as figure
    from analysis.figures import style
    from formctl.search.trials import read_table
    from formctl.store.files import atomic, write_text

    tables = []
    for run in runs:
        rows = read_table(run.path)
        tables.append(rows[rows["state"] == "done"].assign(budget=run.record["budget"]["steps"], study=run.id))
    table = pd.concat(tables, ignore_index=True)
    ranks = analysis.agreement(table)
    live.update(result={"ranks": json.loads(ranks.to_json(orient="records"))})
    write_text(live.path / "trials.csv", table.to_csv(index=False))
    write_text(live.path / "ranks.csv", ranks.to_csv(index=False))
    with atomic(live.path / "pilot.png") as path, style.styled():
        figure.draw_pilot(table, ranks).savefig(path, format="png")
    return ranks
