"""Flights over simulated motion capture and radio, and set-points for real ones: what ``formctl deploy`` does.

The stand-in for the paper's real flights (Sec. VI-D, Table II): the ``real_*`` scenarios on both physics, with the
disturbances of ``conf/deploy``. Its rows are those of ``formctl eval deploy=NAME``.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from analysis.tables import deployment
from formctl.console import say, table
from formctl.deployment import dry_run
from formctl.errors import ConfigError
from formctl.evaluation import scenes
from formctl.evaluation.disturbances import disturbed, read_values
from formctl.evaluation.rows import read_rows
from formctl.settings import compose
from formctl.stages import evaluate
from formctl.store import Run

SCENES = ("real_static", "real_dynamic", "real_mixed")
"""Scenarios of the paper's Table II."""

STANDARD = {"deploy": "mocap"}
"""Choices of a deployment where the call names no other."""

CURVES: dict[str, tuple[float, ...]] = {
    "latency": (0.0, 0.02, 0.04, 0.06, 0.08),  # s
    "position_noise": (0.0, 0.001, 0.002, 0.005, 0.01),  # m
    "mass": (0.9, 0.95, 1.0, 1.05, 1.1),  # of the model's
    "motor_lag": (0.5, 1.0, 1.5, 2.0, 3.0),  # of the model's
    "wind": (0.0, 1.0, 2.0, 3.0),  # m/s, with its gusts
}
"""Points of ``--curves``; a factor holds for every drone and flight."""


def deploy(
    overrides: Sequence[str] = (),
    *,
    policies: Sequence[str] = (),
    baselines: Sequence[str] = (),
    flights: int | None = None,
    sim: str | None = None,
    vary: Sequence[str] = (),
    curves: bool = False,
) -> list[Run]:
    """Fly every method through every scene, physics and disturbance; everything is checked before anything is flown.

    ``vary`` are texts like ``latency=0,0.02``; ``curves`` adds CURVES. Raises ConfigError.
    """
    varied = (CURVES if curves else {}) | read_values(vary)
    names, own, words = evaluate.split_baselines(baselines, overrides)
    evaluate.refuse_contradictions(bool(policies or names))
    words = standard(words, SCENES if not varied else SCENES[-1:])
    words += [] if flights is None else [f"eval.episodes={flights}"]
    planned = []
    physics = evaluate.physics_of(sim or ("torch" if varied else "torch,mujoco"))
    for base in evaluate.compose_on(physics, words, multirun=True):
        methods = evaluate.chosen_methods(base, policies, names, own, words)
        planned += [evaluate.plan(config, methods, scenes.draw(config)) for config in disturbed(base, varied)]
    runs = evaluate.run_all(planned)
    show(runs)
    say("formctl report puts these flights into the deployment table and the robustness figure")
    return runs


def setpoints(
    episode: str,
    overrides: Sequence[str] = (),
    *,
    policies: Sequence[str] = (),
    baselines: Sequence[str] = (),
    out: Path = Path("setpoints.csv"),
) -> None:
    """Write the flown ``RUN:EPISODE`` as set-points for Crazyflies and check them. Raises StoreError, RunFailed."""
    if baselines:
        raise ConfigError("--dry-run flies an episode with the method that flew it: leave --baseline out")
    if len(policies) > 1:
        raise ConfigError("--dry-run flies an episode with the one policy that flew it: give --policy once")
    dry_run.write_setpoints(episode, compose(overrides), out, policies[0] if policies else None)


def standard(words: Sequence[str], real_scenes: Sequence[str]) -> list[str]:
    """The call's settings, with the standard choices where it names none. Raises ConfigError for ``deploy=null``."""
    if "deploy=null" in words:
        raise ConfigError("deploy=null leaves nothing to deploy with: choose a file of conf/deploy")
    typed = {word.partition("=")[0] for word in words}
    added = [f"{group}={choice}" for group, choice in STANDARD.items() if group not in typed]
    return [*added, *([] if "scenario" in typed else ["scenario=" + ",".join(real_scenes)]), *words]


def show(runs: Sequence[Run]) -> None:
    """Ten flights as in Table II, all flights beside them, and what ten flights could have shown."""
    lines = [line for run in runs for line in _lines(read_rows(run.path / "episodes.parquet"))]
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
    table(columns, lines, title=deployment.TITLE)


def _lines(rows: Any) -> Iterator[tuple[str, ...]]:
    for (method, scenario, physics, deploy), part in rows.groupby(["method", "scenario", "sim", "deploy"], sort=False):
        seen = deployment.summary(part)
        fm = "none succeeded" if seen.fm is None else f"{seen.fm:.3f}"
        ten = f"{seen.ten / seen.tried:.1f} ({seen.ten} of {seen.tried})"
        all_of = f"{seen.rate.value:.3f} ({seen.rate.k} of {seen.rate.n})"
        interval = f"{seen.rate.low:.3f} to {seen.rate.high:.3f}"
        yield method, scenario, physics, deploy, ten, all_of, interval, f"{seen.least} to {seen.most} of 10", fm
