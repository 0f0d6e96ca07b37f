"""Rates of evaluations on the terminal, and why episodes failed."""

from collections.abc import Sequence
from typing import Any

import pandas as pd

from analysis.data.text import counted
from analysis.stats import wilson
from formctl.console import say, table
from formctl.evaluation.rows import failure_reasons, mean_fm, read_rows
from formctl.evaluation.scenes import AXES
from formctl.stages import hints
from formctl.store import Run

SCENE = ("method", "columns", "balls", "ball_aim", "sim", "message_period", "message_delay", "message_loss")
"""Columns in which the lines of the table differ."""


def show(runs: Sequence[Run]) -> None:
    """The methods' rates, scene by scene, and why episodes failed, each reason with RUN:EPISODE of one of them."""
    lines, failed = [], []
    several = len({run.config["sim"] for run in runs}) > 1
    for run in runs:
        rows = read_rows(run.path / "episodes.parquet")
        for (name, _, balls, aim, sim, *_), part in rows.groupby([*SCENE], sort=False):
            hits, count = int(part["cfr"].sum()), len(part)
            low, high = wilson(hits, count)
            fm = mean_fm(part)
            scene = ", ".join(counted(int(part[axis].iloc[0]), axis[:-1]) for axis in AXES)
            scene += f" aimed at {aim}" if balls else ""
            scene += f", {sim}" if several else ""
            scene += messages(part)
            rate, interval = f"{hits / count:.3f} ({hits} of {count})", f"{low:.3f} to {high:.3f}"
            lines.append((name, scene, rate, interval, "none succeeded" if fm is None else f"{fm:.3f}"))
            failed += [(name, scene, why, n, f"{hints.typed(run)}:{row}") for why, n, row in failure_reasons(part)]
    table(("method", "scene", "CFR", "95 % interval", "FM of successes"), lines)
    if failed:
        table(("method", "scene", "failed by", "episodes", "one of them, for replay"), failed)
    for sentence in dict.fromkeys(filter(None, (training_share(run.record["method"]) for run in runs))):
        say(sentence)


def messages(rows: pd.DataFrame) -> str:
    """What messages between drones suffered in a scene's rows; nothing where there were none."""
    period, delay, loss = (float(rows[f"message_{name}"].iloc[0]) for name in ("period", "delay", "loss"))
    return f", messages {1000 * delay:g} ms late, {loss:.0%} lost" if period else ""


def training_share(method: dict[str, Any]) -> str:
    """What a learned baseline's training had of the published one; nothing about other methods."""
    if "published_steps" not in method:
        return ""
    minutes = f" in {method['minutes']:g} min" if "minutes" in method else ""
    share = method["steps"] / method["published_steps"]
    return (
        f"{method['name']} was trained for {method['steps']:,} steps{minutes}, {share:.2%} of the "
        f"{method['published_steps']:,} that were published"
    )
