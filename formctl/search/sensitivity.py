"""``formctl search --sensitivity``: the study's stored episodes judged by other thresholds, without training again."""

from pathlib import Path
from typing import TYPE_CHECKING

from analysis.stats import sensitivity
from formctl.console import say, table, warn
from formctl.evaluation.rows import read_rows
from formctl.search import winner
from formctl.search.results import StudyView
from formctl.search.table import Row
from formctl.store import Run
from formctl.store.files import StoreError, atomic

if TYPE_CHECKING:
    import pandas as pd


def show(view: StudyView) -> None:
    """Print the winner at each threshold and keep all rates in ``sensitivity.csv``. Raises StoreError."""
    episodes = flown(view.folder, view.rows())
    rates = sensitivity.sweep(episodes, Run(view.folder).config["eval"])
    best = sensitivity.winners(rates)
    say(f"study {view.name}: {len(episodes)} trials, {len(next(iter(episodes.values())))} episodes each")
    say("thresholds: quantiles of what the trials flew, those in use and the paper's FM")
    table(
        ("FM below (m)", "throttle change below", "winner", "its SR", "median SR", "rank correlation"),
        [
            (
                f"{row.formation_threshold:.3g}",
                f"{row.action_threshold:.3g}" + " (in use)" * bool(row.in_use),
                row.trial if row.sr else "nobody",
                f"{row.sr:.3f}",
                f"{row.median:.3f}",
                f"{row.spearman:.2f}",
            )
            for row in best.itertuples()
        ],
    )
    usual = best.loc[best["in_use"], "trial"].iloc[0]
    decided = best[best["sr"] > 0]
    kept = int((decided["trial"] == usual).sum())
    say(f"trial {usual} wins at {kept} of the {len(decided)} settings that somebody satisfies")
    with atomic(view.folder / "sensitivity.csv") as path:
        rates.to_csv(path, index=False)
    say(f"all rates: {view.folder / 'sensitivity.csv'}")


def flown(folder: Path, trials: list[Row]) -> "dict[int, pd.DataFrame]":
    """Episodes of every finished trial whose folder is here, the highest SR first. Raises StoreError for none."""
    done = winner.by_rate(trials)
    paths = {row["trial"]: (folder / str(row["policy"])).with_name("episodes.parquet") for row in done}
    there = {trial: read_rows(path) for trial, path in paths.items() if path.is_file()}
    if not there:
        raise StoreError(f"{folder} has no finished trial with its episodes; `formctl search` makes them")
    if len(there) < len(done):
        warn(f"{len(done) - len(there)} trials are left out: their episodes are on other hosts")
    return there
