"""``formctl bench eval``: seconds that an evaluation takes, on the torch world and on MuJoCo."""

import time
from typing import TYPE_CHECKING, Annotated

import typer

from formctl.commands.options import Overrides, configs

if TYPE_CHECKING:
    from formctl.evaluation.methods import Method
    from formctl.settings import Config


def flights(
    policy: Annotated[str, typer.Option(metavar="RUN|FILE|NAME", help="The policy that is flown.")],
    overrides: Overrides = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes on the torch world.")] = 1000,
    mujoco: Annotated[int, typer.Option(min=1, help="Episodes on MuJoCo, scaled to as many.")] = 100,
) -> None:
    """Seconds that an evaluation of a policy takes, on the torch world and on MuJoCo.

    With eval.compile=true also on the torch world compiled.
    """
    from formctl import console
    from formctl.engines import workers
    from formctl.evaluation import methods
    from formctl.settings import build
    from formctl.store import provenance

    (config,) = configs(overrides)
    method = methods.policy(policy, config.runs)
    build.use_threads(config)
    run = provenance.new_run(config, "bench", scenario=config.scenario.name, method=method.facts)
    with run.work() as live:
        flown = {"torch": episodes, "mujoco": mujoco} | ({"torch, compiled": episodes} if config.eval.compile else {})
        timed = {kind: seconds(config, method, kind, count) for kind, count in flown.items()}
        each = {kind: timed[kind] / flown[kind] for kind in timed}
        ratio = {kind: each[kind] / each["torch"] for kind in timed}
        live.update(result={"seconds": timed, "episodes": flown, "ratio": ratio})
    rows = [
        (kind, f"{flown[kind]:,}", f"{timed[kind]:.1f}", f"{1000 * each[kind]:.1f}", f"{ratio[kind]:.2f}")
        for kind in timed
    ]
    title = f"{method.name}, scenario {config.scenario.name}, {workers.cores()} processes"
    console.table(("sim", "episodes", "seconds", "seconds for 1,000", "of torch"), rows, title=title)
    if config.eval.compile:
        console.say("compiled: with the time to compile, which is less where the same was compiled before")


def seconds(config: "Config", method: "Method", kind: str, episodes: int) -> float:
    """Seconds that ``episodes`` of the configured scenario take on a physics, ``compiled`` where its name says so."""
    from envs.bank import Bank
    from formctl.engines import workers
    from formctl.evaluation import evaluate, scenes
    from formctl.settings import build, restore

    sim, _, compiled = kind.partition(", ")
    chosen = restore(config.tree | {"sim": sim, "eval": config.tree["eval"] | {"compile": bool(compiled)}})
    scene = scenes.EvaluationScene(build.world(chosen), Bank.create(chosen.scenario, episodes, chosen.eval.seed))
    begun = time.perf_counter()
    evaluate.evaluate(method, [scene], chosen, jobs=workers.cores())
    return time.perf_counter() - begun
