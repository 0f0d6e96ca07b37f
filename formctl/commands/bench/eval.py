"""``formctl bench eval``: seconds that an evaluation takes, on the torch world and on MuJoCo."""

import time
from typing import TYPE_CHECKING, Annotated

import typer

from formctl.options import Overrides, configs

if TYPE_CHECKING:
    from formctl.config import Config
    from formctl.flying.methods import Method


def flights(
    policy: Annotated[str, typer.Option(metavar="RUN|FILE|NAME", help="The policy that is flown.")],
    overrides: Overrides = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes on the torch world.")] = 1000,
    mujoco: Annotated[int, typer.Option(min=1, help="Episodes on MuJoCo, scaled to as many.")] = 100,
) -> None:
    """Seconds that an evaluation of a policy takes, on the torch world and on MuJoCo."""
    from formctl import build, console
    from formctl.engines import workers
    from formctl.flying import methods
    from formctl.store import provenance

    (config,) = configs(overrides)
    method = methods.policy(policy, config.runs)
    build.use_threads(config)
    run = provenance.new_run(config, "bench", scenario=config.scenario.name, method=method.facts)
    with run.work() as live:
        timed = {sim: seconds(config, method, sim, count) for sim, count in (("torch", episodes), ("mujoco", mujoco))}
        flown = {"torch": episodes, "mujoco": mujoco}
        each = {sim: timed[sim] / flown[sim] for sim in timed}
        ratio = each["mujoco"] / each["torch"]
        live.update(result={"seconds": timed, "episodes": flown, "ratio": ratio})
    rows = [(sim, f"{flown[sim]:,}", f"{timed[sim]:.1f}", f"{1000 * each[sim]:.1f}") for sim in timed]
    title = f"{method.name}, scenario {config.scenario.name}, {workers.cores()} processes"
    console.table(("sim", "episodes", "seconds", "seconds for 1,000"), rows, title=title)
    console.say(f"MuJoCo takes {ratio:.1f} times as long")


def seconds(config: "Config", method: "Method", sim: str, episodes: int) -> float:
    """Seconds that ``episodes`` of the configured scenario take."""
    from envs.bank import Bank
    from formctl import build
    from formctl.config import restore
    from formctl.engines import workers
    from formctl.flying import evaluation

    chosen = restore(config.tree | {"sim": sim})
    scene = evaluation.Scene(build.world(chosen), Bank.create(chosen.scenario, episodes, chosen.eval.seed))
    begun = time.perf_counter()
    evaluation.fly(method, [scene], chosen, jobs=workers.cores())
    return time.perf_counter() - begun
