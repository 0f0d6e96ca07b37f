"""``formctl deploy``: flights over simulated motion capture and radio, and set-points for real ones."""

from pathlib import Path
from typing import Annotated

import typer

from formctl.commands.options import Baselines, Overrides, Policies, ShowConfig, show_settings


def command(
    overrides: Overrides = None,
    policy: Policies = None,
    baseline: Baselines = None,
    flights: Annotated[int | None, typer.Option(min=1, help="Flights per scene; profiles set this.")] = None,
    sim: Annotated[str | None, typer.Option(help="Physics: torch,mujoco, or one of them (curves: torch).")] = None,
    vary: Annotated[
        list[str] | None, typer.Option(metavar="KEY=A,B,..", help="Fly each value of a deploy key; may be repeated.")
    ] = None,
    curves: Annotated[bool, typer.Option("--curves", help="Vary latency, noise, mass, motor lag and wind.")] = False,
    dry_run: Annotated[
        str | None, typer.Option("--dry-run", metavar="RUN:EPISODE", help="Write a flown episode as set-points.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Where --dry-run writes the set-points.")] = Path("setpoints.csv"),
    cfg: ShowConfig = False,
) -> None:
    """Fly over simulated motion capture and radio; make set-points.

    Without a scenario: the three real-flight scenes, at 500 Hz, with the noise, latency, lost packets and craft of
    deploy=mocap; ten flights, as in the paper, beside all of them. --curves varies one disturbance at a time in
    scenario real_mixed. --dry-run turns an evaluated episode into set-points for Crazyflies and checks them; it needs
    no drone and no cflib.
    """
    from formctl.stages import deploy

    words = list(overrides or [])
    if cfg:
        show_settings(words if dry_run is not None else deploy.standard(words, deploy.SCENES), multirun=dry_run is None)
    if dry_run is not None:
        deploy.setpoints(dry_run, words, policies=policy or [], baselines=baseline or [], out=out)
        return
    deploy.deploy(
        words,
        policies=policy or [],
        baselines=baseline or [],
        flights=flights,
        sim=sim,
        vary=vary or [],
        curves=curves,
    )
