"""``formctl deploy``: flights over simulated motion capture and radio, and set-points for real ones.

The stand-in for the paper's real flights (Sec. VI-D, Table II): the ``real_*`` scenarios at 500 Hz on both physics,
with the disturbances of ``conf/deploy``. Its rows are those of ``formctl eval deploy=NAME``.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from formctl.commands.options import Baselines, Overrides, Policies, ShowConfig, configs

if TYPE_CHECKING:
    from formctl.store import Run

SCENES = ("real_static", "real_dynamic", "real_mixed")
"""Scenarios of the paper's Table II."""

STANDARD = {"deploy": "mocap"}
"""Choices of a deployment where the call names no other."""

CURVES = {
    "latency": (0.0, 0.02, 0.04, 0.06, 0.08),  # s
    "position_noise": (0.0, 0.001, 0.002, 0.005, 0.01),  # m
    "mass": (0.9, 0.95, 1.0, 1.05, 1.1),  # of the model's
    "motor_lag": (0.5, 1.0, 1.5, 2.0, 3.0),  # of the model's
    "wind": (0.0, 1.0, 2.0, 3.0),  # m/s, with its gusts
}
"""Points of ``--curves``; a factor holds for every drone and flight."""


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
    from formctl.flying.disturbances import read_values

    words = list(overrides or [])
    if dry_run is not None:
        from formctl.flying import rehearsal

        chosen = flyer(policy or [], baseline or [])
        (config,) = configs(words, show=cfg)
        rehearsal.rehearse(dry_run, config, out, chosen)
        return
    varied = (CURVES if curves else {}) | read_values(vary or [])
    fly(words, policy or [], baseline or [], flights, sim or ("torch" if varied else "torch,mujoco"), varied, cfg)


def flyer(policies: Sequence[str], baselines: Sequence[str]) -> str | None:
    """The policy that flew the episode of ``--dry-run``, where the call says. Raises ConfigError for other methods."""
    from formctl.errors import ConfigError

    if baselines:
        raise ConfigError("--dry-run flies an episode with the method that flew it: leave --baseline out")
    if len(policies) > 1:
        raise ConfigError("--dry-run flies an episode with the one policy that flew it: give --policy once")
    return policies[0] if policies else None


def fly(
    words: list[str],
    policies: Sequence[str],
    baselines: Sequence[str],
    flights: int | None,
    physics: str,
    varied: dict[str, tuple[float, ...]],
    cfg: bool,
) -> None:
    """Fly every method through every scene, physics and disturbance; everything is checked before anything is flown."""
    from formctl.commands import eval as evaluate
    from formctl.console import say
    from formctl.flying import evaluation, methods
    from formctl.flying.disturbances import disturbed

    names, own, words = evaluate.split_baselines(baselines, words)
    evaluate.refuse_contradictions(bool(policies or names), None, False)
    words = standard(words, SCENES if not varied else SCENES[-1:])
    words += [] if flights is None else [f"eval.episodes={flights}"]
    planned = []
    for base in evaluate.on_each(evaluate.sims(physics), words, True, cfg):
        flown = [methods.policy(text, base.runs) for text in policies] + [methods.baseline(n, own) for n in names]
        methods.check_observation(base, flown, words)
        for config in disturbed(base, varied):
            scenes = evaluate.drawn(config, {})
            planned.append((config, evaluation.check(config, flown, scenes), scenes))
    invocation = evaluate.invocation_of(planned)
    runs = [
        run
        for config, flown, scenes in planned
        for run in evaluate.execute(config, flown, scenes, invocation=invocation)
    ]
    show(runs)
    say("formctl report puts these flights into the deployment table and the robustness figure")


def standard(words: Sequence[str], scenes: Sequence[str]) -> list[str]:
    """The call's settings, with the standard choices where it names none. Raises ConfigError for ``deploy=null``."""
    from formctl.errors import ConfigError

    if "deploy=null" in words:
        raise ConfigError("deploy=null leaves nothing to deploy with: choose a file of conf/deploy")
    typed = {word.partition("=")[0] for word in words}
    added = [f"{group}={choice}" for group, choice in STANDARD.items() if group not in typed]
    return [*added, *([] if "scenario" in typed else ["scenario=" + ",".join(scenes)]), *words]


def show(runs: "Sequence[Run]") -> None:
    """Ten flights as in Table II, all flights beside them, and what ten flights could have shown."""
    from analysis import deployment
    from formctl import console
    from formctl.flying import evaluation

    lines = [line for run in runs for line in _lines(evaluation.read_rows(run.path / "episodes.parquet"))]
    columns = (
        "method",
        "scenario",
        "sim",
        "deploy",
        "CFR of ten",
        "CFR of all",
        "95 % interval",
        "ten could show",
        "FM",
    )
    console.table(columns, lines, title=deployment.TITLE)


def _lines(rows: Any) -> Iterator[tuple[str, ...]]:
    from analysis import deployment

    for (method, scenario, physics, deploy), part in rows.groupby(["method", "scenario", "sim", "deploy"], sort=False):
        seen = deployment.summary(part)
        fm = "none succeeded" if seen.fm is None else f"{seen.fm:.3f}"
        ten = f"{seen.ten / seen.tried:.1f} ({seen.ten} of {seen.tried})"
        all_of = f"{seen.rate.value:.3f} ({seen.rate.k} of {seen.rate.n})"
        interval = f"{seen.rate.low:.3f} to {seen.rate.high:.3f}"
        yield method, scenario, physics, deploy, ten, all_of, interval, f"{seen.least} to {seen.most} of 10", fm
