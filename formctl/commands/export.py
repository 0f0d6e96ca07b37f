"""``formctl export``: a policy as ONNX or as C, with a contract how to feed it and a proof that it is the same."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from formctl.commands.options import Overrides, ShowConfig, configs

if TYPE_CHECKING:
    from algos.export.onnx import Parity
    from formctl.deployment.export import CExport


def command(
    policy: Annotated[
        str, typer.Argument(metavar="RUN|FILE|NAME", help="A trained policy; with --check, the folder of an export.")
    ],
    overrides: Overrides = None,
    out: Annotated[Path | None, typer.Option(help="Write to this folder instead of RUNS/export/NAME/ID.")] = None,
    c: Annotated[
        Path | None, typer.Option("--c", metavar="DIR", help="Write C99 for a microcontroller to this folder.")
    ] = None,
    target: Annotated[str, typer.Option(help="What the C has to fit into: crazyflie.")] = "crazyflie",
    neighbours: Annotated[int, typer.Option(min=1, help="Other drones that the C has room for.")] = 5,
    balls: Annotated[int, typer.Option(min=1, help="Balls that the C has room for.")] = 5,
    columns: Annotated[int, typer.Option(min=1, help="Columns that the C has room for.")] = 32,
    observations: Annotated[int, typer.Option(min=1, help="Recorded observations that the proof compares.")] = 1000,
    check: Annotated[
        bool, typer.Option("--check", help="Verify an export instead: its hashes, and C by compiling.")
    ] = False,
    cfg: ShowConfig = False,
) -> None:
    """Write a policy as ONNX, or with --c as C, with a contract and a proof of parity.

    Both take measurements in SI units and give body rates and thrust; the task (course, speed, height, formation) and
    the drone's limits are those of the settings: scenario=real_mixed drone.rate_clip=0.785
    drone.thrust_range=[0.4,0.9] for real flights.
    """
    from formctl.console import say
    from formctl.deployment import export
    from formctl.errors import ConfigError

    if check:
        described = export.check(Path(policy))
        say(f"{policy}: {len(described['files'])} files as they were exported ({described['policy']['name']})")
        return
    words = list(overrides or [])
    (config,) = configs(words, show=cfg)
    if c is not None:
        from algos.export.c import TARGETS
        from algos.export.layout import Bounds

        if target not in TARGETS:
            raise ConfigError(f"there is no target {target!r}; the choices are {', '.join(TARGETS)}")
        given = export.subject(policy, config, words)
        show_c(export.to_c(given, c, observations, target, Bounds(neighbours, balls, columns)))
        return
    from algos.export import onnx

    onnx.require()
    given = export.subject(policy, config, words)
    say(f"about to trace {given.method.name} for scenario {config.scenario.name}: a minute or two")
    run, proofs = export.to_onnx(given, out, observations)
    show(proofs, "onnxruntime")
    say(f"policy:   {run.path / 'policy.onnx'}")
    say(f"contract: {run.path / 'contract.json'}")


def show(proofs: "list[Parity]", runtime: str) -> None:
    """The proofs as a table."""
    from formctl import console
    from formctl.deployment.contract import TOLERANCE

    rows = [
        (f"{p.observations:,}", p.columns, p.balls, *(f"{value:.1e}" for value in p.largest.values()), "equal")
        for p in proofs
    ]
    names = ("rates, rad/s", "thrust", "command")
    console.table(
        ("observations", "columns", "balls", *names, f"command within {TOLERANCE:.0e}"),
        rows,
        title=f"torch against {runtime}",
    )


def show_c(exported: "CExport") -> None:
    """The proofs, and what the policy takes of its target."""
    from formctl import console
    from formctl.deployment.toolchain import INSTALL

    show(exported.proofs, "compiled C")
    found = exported.footprint
    rows = [
        ("flash", f"{exported.flash / 1024:.1f} KiB", "" if found is None else f"{found.flash / 1024:.1f} KiB"),
        ("stack and inputs", f"{exported.ram / 1024:.1f} KiB", ""),
        ("stack", "", "" if found is None else f"{found.stack / 1024:.1f} KiB"),
        ("multiply-accumulates", f"{exported.multiply_accumulates:,}", ""),
        ("instructions per inference", "", "" if found is None else f"{found.instructions:,}"),
    ]
    console.table(("it takes", "at most", "measured on an emulated Cortex-M4"), rows)
    if found is None:
        console.say(f"nothing was measured on a Cortex-M4: {INSTALL}")
    console.say(f"C:           {exported.run.path / 'policy.h'}")
    console.say(f"application: {exported.run.path / 'crazyflie'} (nobody has flown it: see its README.md)")
    console.say(f"contract:    {exported.run.path / 'contract.json'}")
