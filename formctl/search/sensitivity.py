"""``formctl search --sensitivity``: the study's stored episodes judged by other thresholds, without training again."""

from typing import TYPE_CHECKING

from analysis.stats import sensitivity
from formctl import console
from formctl.evaluation.rows import read_rows
from formctl.search import overview
from formctl.search.ledger import Ledger
from formctl.store.files import StoreError, atomic

if TYPE_CHECKING:
    import pandas as pd

    from formctl.store import Run


def show(run: "Run", study: Ledger) -> None:
    """Print the winner at each threshold and keep all rates in ``sensitivity.csv``. Raises StoreError."""
    rows = episodes(run, study)
    table = sensitivity.sweep(rows, run.config["eval"])
    best = sensitivity.winners(table)
    console.say(f"study {run.path.parent.name}: {len(rows)} trials, {len(next(iter(rows.values())))} episodes each")
    console.say("thresholds: quantiles of what the trials flew, those in use and the paper's FM")
    columns = ("FM below (m)", "throttle change below", "winner", "its SR", "median SR", "rank correlation")
    console.table(
        columns,
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
    console.say(f"trial {usual} wins at {kept} of the {len(decided)} settings that somebody satisfies")
    with atomic(run.path / "sensitivity.csv") as path:
        table.to_csv(path, index=False)
    console.say(f"all rates: {run.path / 'sensitivity.csv'}")


def episodes(run: "Run", study: Ledger) -> "dict[int, pd.DataFrame]":
    """Episodes of every finished trial whose folder is here, the best trial first. Raises StoreError for none."""
    trials = overview.top(study, 1_000_000)
    paths = {row["trial"]: (run.path / str(row["policy"])).with_name("episodes.parquet") for row in trials}
    there = {trial: read_rows(path) for trial, path in paths.items() if path.is_file()}
    if not there:
        raise StoreError(f"{run.path} has no finished trial with its episodes; `formctl search` makes them")
    if len(there) < len(trials):
        console.warn(f"{len(trials) - len(there)} trials are left out: their episodes are on other hosts")
    return there
