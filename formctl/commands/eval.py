"""``formctl eval``: policies and baselines on the same stored scenarios, one row per episode."""

from pathlib import Path
from typing import Annotated

import typer

from formctl.commands.options import Baselines, Multirun, Overrides, Policies, ShowConfig, show_settings


def command(
    overrides: Overrides = None,
    policy: Policies = None,
    baseline: Baselines = None,
    bank: Annotated[Path | None, typer.Option(help="Fly exactly the scenarios of this bank.")] = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="Episodes per scene, without a bank.")] = None,
    out: Annotated[Path | None, typer.Option(help="Write all rows to this Parquet file as well.")] = None,
    grid: Annotated[
        list[str] | None, typer.Option(help="Scenes to fly, e.g. --grid columns=5,10,15,20 balls=0; may be repeated.")
    ] = None,
    body: Annotated[
        str | None, typer.Option(help="What computes policies: torch, onnx, c, cortex-m4 (emulated); or several.")
    ] = None,
    sim: Annotated[str | None, typer.Option(help="Physics to fly on: torch, mujoco, or torch,mujoco for both.")] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Processes that share the episodes [default: all cores]."),
    ] = None,
    record: Annotated[
        str | None, typer.Option(metavar="WHICH", help="Record episodes: worst=5, failed=5, first=3 or ids=4,17.")
    ] = None,
    multirun: Multirun = False,
    cfg: ShowConfig = False,
) -> None:
    """Fly policies and baselines on the same stored scenarios and write one row per episode."""
    from formctl.stages import evaluate

    words = list(overrides or [])
    if cfg:
        show_settings(evaluate.split_baselines(baseline or [], evaluate.split_grid(grid or [], words)[1])[2], multirun)
    evaluate.evaluate(
        words,
        policies=policy or [],
        baselines=baseline or [],
        bank=bank,
        episodes=episodes,
        grid=grid or [],
        body=body,
        sim=sim,
        jobs=jobs,
        record=record,
        out=out,
        multirun=multirun,
    )
