"""How short a search trial may be and still rank weight vectors: the same vectors at several budgets.

python -m tests.benchmarks.pilot --trials 8 --budget 100000 --budget 400000 --out pilot
"""

from pathlib import Path
from typing import Annotated

import pandas as pd
import typer

from analysis.figures import style
from formctl.console import table
from formctl.search.table import read_table
from formctl.settings import compose
from formctl.stages import search
from tests.benchmarks import agreement as ranking
from tests.benchmarks import pilot_figure as figure

BUDGETS = (100_000, 200_000, 400_000, 800_000)
"""Steps per trial where the call names none."""


def main(
    overrides: Annotated[list[str] | None, typer.Argument()] = None,
    trials: Annotated[int, typer.Option(min=3, help="Weight vectors, the same at every budget.")] = 8,
    budget: Annotated[list[int] | None, typer.Option(min=1, help="Steps per trial; to be repeated.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for trials.csv, ranks.csv and pilot.png.")] = Path("pilot"),
) -> None:
    """Search at every budget, then print how well each ranks the vectors as the longest does."""
    tables = []
    for steps in sorted(set(budget or BUDGETS)):
        name = f"pilot_{steps}"
        config = compose([*(overrides or []), f"search.trials={trials}", f"search.steps={steps}", f"name={name}"])
        run = search.execute(config, name)
        rows = read_table(run.path)
        tables.append(rows[rows["state"] == "done"].assign(budget=steps, study=run.id))
    found = pd.concat(tables, ignore_index=True)
    ranks = ranking.agreement(found)
    out.mkdir(parents=True, exist_ok=True)
    found.to_csv(out / "trials.csv", index=False)
    ranks.to_csv(out / "ranks.csv", index=False)
    with style.styled():
        figure.draw_pilot(found, ranks).savefig(out / "pilot.png")
    table(list(ranks.columns), ranks.itertuples(index=False), title=f"{trials} weight vectors; written to {out}")


if __name__ == "__main__":
    typer.run(main)
