"""``formctl bench``: how fast world and learners run on this machine, and what the search's store costs."""

import csv
import io
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from formctl.commands import bench_planners
from formctl.commands.bench_learn import learn
from formctl.commands.bench_train import train
from formctl.options import Overrides, configs

if TYPE_CHECKING:
    from envs.formation import WorldSpec
    from formctl.config import Config
    from formctl.methods import Method
    from formctl.store import Run

app = typer.Typer(help="Measure the speed of world, learners and store on this machine.", add_completion=False)

SIZES = (256, 1024, 4096)
"""Environments side by side."""


@dataclass(frozen=True)
class Timing:
    """One line of the benchmark. An environment step moves all drones of one environment."""

    world: str  # torch, or mujoco.rollout (rigid bodies and contacts only: no observation, no reward)
    mode: str  # eager or compiled
    threads: int
    environments: int
    drones: int  # in each environment
    steps_per_second: float  # environment steps
    compile_seconds: float | None


@app.callback()
def bench() -> None:
    """Measure the speed of world, learners and store on this machine."""


@app.command()
def env(
    overrides: Overrides = None,
    threads: Annotated[list[int] | None, typer.Option(min=1, help="Torch threads; may be repeated. Default 1.")] = None,
    environments: Annotated[list[int] | None, typer.Option(min=1, help="Default 256, 1024 and 4096.")] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="Length of each measurement.")] = 3.0,
    compiled: Annotated[bool, typer.Option(help="Measure the compiled world as well.")] = True,
) -> None:
    """Environment steps per second, observation and reward vector included; MuJoCo's rollout as a yardstick."""
    from formctl import console, provenance

    (config,) = configs(overrides)
    counts, sizes = threads or [1], environments or list(SIZES)
    modes = ["eager", *(["compiled"] if compiled else [])]
    plan = [(count, mode, size) for count in counts for mode in modes for size in sizes]
    console.say(f"about to measure {len(plan)} settings, {seconds:g} s each; compiling takes longer than measuring")
    run = provenance.new_run(config, "bench", scenario=config.scenario.name)
    with run.work() as live:
        timings = list(measure(config, plan, seconds)) + list(yardstick(config, counts, sizes))
        live.update(result={"timings": [asdict(timing) for timing in timings]})
        write_csv(live, timings)
    drones = timings[0].drones
    columns = ("world", "mode", "threads", "environments", f"env steps/s, {drones} drones each", "seconds to compile")
    console.table(columns, [cells(timing) for timing in timings], title=f"scenario {config.scenario.name}")
    console.say(f"table: {run.path / 'timings.csv'}")


@app.command("eval")
def flights(
    policy: Annotated[str, typer.Option(metavar="RUN|FILE|NAME", help="The policy that is flown.")],
    overrides: Overrides = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes on the torch world.")] = 1000,
    mujoco: Annotated[int, typer.Option(min=1, help="Episodes on MuJoCo, scaled to as many.")] = 100,
) -> None:
    """Seconds that an evaluation of a policy takes, on the torch world and on MuJoCo."""
    from formctl import build, console, methods, provenance, workers

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
    from formctl import build, evaluation, workers
    from formctl.config import restore

    chosen = restore(config.tree | {"sim": sim})
    scene = evaluation.Scene(build.world(chosen), Bank.create(chosen.scenario, episodes, chosen.eval.seed))
    begun = time.perf_counter()
    evaluation.fly(method, [scene], chosen, jobs=workers.cores())
    return time.perf_counter() - begun


@app.command("store")
def store_command(
    overrides: Overrides = None,
    trials: Annotated[int, typer.Option(min=1, help="Trials that the study has already.")] = 10_000,
    events: Annotated[int, typer.Option(min=1, help="Events of each kind that are timed.")] = 100,
) -> None:
    """What the search's store costs on SQLite: milliseconds per trial event, seconds per --status."""
    from formctl import console, provenance

    (config,) = configs(overrides)
    from formctl import storebench

    run = provenance.new_run(config, "bench", "store")
    study = provenance.new_run(config, "search", "store", folder=run.path / "runs" / "search" / "store" / "study")
    console.say(f"about to fill a study with {trials:,} trials and time {events} events of each kind in {run.path}")
    with run.work() as live:
        costs = [*storebench.measure(study.path, trials, events), storebench.status(study, trials)]
        live.update(result={"costs": [asdict(cost) for cost in costs]})
    figures = [(cost.milliseconds, cost.worst, cost.processor) for cost in costs]
    lines = [
        (cost.event, f"{cost.trials:,}", cost.times, *(f"{figure:.1f}" for figure in own))
        for cost, own in zip(costs, figures, strict=True)
    ]
    console.table(("event", "trials in the study", "times", "ms each", "95 % under", "of it processor"), lines)


app.command("planners")(bench_planners.command)
app.command("train")(train)
app.command("learn")(learn)


def measure(config: "Config", plan: list[tuple[int, str, int]], seconds: float) -> Iterator[Timing]:
    """Time the torch world in every setting of ``plan`` (threads, mode, environments)."""
    import torch

    from formctl import build
    from formctl.console import track

    before = torch.get_num_threads()
    try:
        for threads, mode, size in track(plan, "bench", "settings"):
            torch.set_num_threads(threads)
            yield measure_one(build.world(config), threads, mode, size, seconds)
    finally:
        torch.set_num_threads(before)


def measure_one(world: "WorldSpec", threads: int, mode: str, size: int, seconds: float) -> Timing:
    """Steps per second of ``size`` environments under random commands, started again every 50 steps."""
    import torch

    from algos.compilation import Compiler
    from envs.formation import FormationEnv
    from envs.scenarios import sample

    torch.compiler.reset()
    compiler = Compiler(mode == "compiled")
    env = FormationEnv(world).compiled(compiler)
    scenarios = sample(world.scenario, size, seed=0)
    start = env.reset(scenarios)
    actions = torch.rand((50, size, env.drones, 4), generator=torch.Generator().manual_seed(0)) * 2 - 1

    def advance(steps: int) -> None:
        state = start
        for action in actions[:steps]:
            env.observe(state, scenarios)
            state, _, _ = env.step(state, action, scenarios)

    with torch.no_grad():
        begun = time.perf_counter()
        advance(2)
        first = time.perf_counter() - begun
        done, begun = 0, time.perf_counter()
        while (elapsed := time.perf_counter() - begun) < seconds or done == 0:
            advance(len(actions))
            done += len(actions)
    if mode == "compiled" and not compiler.enabled:
        mode = "not compiled: no compiler"
    return Timing(
        "torch", mode, threads, size, env.drones, done * size / elapsed, first if mode == "compiled" else None
    )


def yardstick(config: "Config", counts: list[int], sizes: list[int]) -> Iterator[Timing]:
    """MuJoCo's own rollout of the same bodies."""
    from envs.mujoco_env import rollout_rate
    from envs.shapes import slots
    from formctl import build

    world = build.world(config)
    drones = len(slots(world.scenario))
    for threads in counts:
        for size in sizes:
            rate = rollout_rate(world, size, threads=0 if threads == 1 else threads)
            yield Timing("mujoco.rollout", "native", threads, size, drones, rate, None)


def write_csv(live: "Run", timings: list[Timing]) -> None:
    """``timings.csv`` in the run's folder."""
    from formctl.files import write_text

    text = io.StringIO()
    writer = csv.DictWriter(text, list(asdict(timings[0])))
    writer.writeheader()
    writer.writerows(asdict(timing) for timing in timings)
    write_text(live.path / "timings.csv", text.getvalue())


def cells(timing: Timing) -> tuple[str, ...]:
    """A timing as a line of the table."""
    compiling = "" if timing.compile_seconds is None else f"{timing.compile_seconds:.0f}"
    size = f"{timing.environments:,}"
    return timing.world, timing.mode, str(timing.threads), size, f"{timing.steps_per_second:,.0f}", compiling
