"""How fast worlds, learners and evaluations run on this machine: what ``formctl bench`` does."""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import torch

from algos.compilation import Compiler
from algos.curriculum import CurriculumSpec, Period
from algos.trainer import Trainer, TrainSettings
from envs.bank import Bank
from envs.formation import FormationEnv, WorldSpec
from envs.scenarios import sample
from formctl.console import say, table, track
from formctl.engines import workers
from formctl.evaluation import methods
from formctl.evaluation.evaluate import evaluate
from formctl.evaluation.scenes import EvaluationScene
from formctl.settings import Config, build, compose
from formctl.store import provenance

SIZE = 1024
"""Environments side by side where the world alone is measured."""

RESTART = 50
"""Steps after which its episodes start again."""

ENDLESS = 10**12
"""Environment steps that no measurement uses up."""


@dataclass(frozen=True)
class Speed:
    """One line of the table. An environment step moves all drones of one environment."""

    what: str
    mode: str  # eager or compiled
    environments: int
    steps_per_second: float  # environment steps
    first_seconds: float  # before the first measured step: compiling and what is only done once


def bench(overrides: Sequence[str] = (), *, seconds: float = 5.0, episodes: int = 200) -> list[Speed]:
    """Measure world, learner and evaluation, each for ``seconds`` or longer; the speeds, recorded with a run."""
    config = compose(overrides)
    modes = (False, True) if config.train.compile else (False,)
    jobs: list[Callable[[], Speed]] = []
    for compiled in modes:
        jobs.append(lambda compiled=compiled: world_speed(build.world(config), SIZE, compiled, seconds))  # type: ignore[misc]
        jobs.append(lambda compiled=compiled: learner_speed(config, compiled, seconds))  # type: ignore[misc]
    jobs.append(lambda: evaluation_speed(config, episodes))
    compiling = "; compiling takes a minute or more each" if config.train.compile else ""
    say(f"about to measure {len(jobs)} speeds, {seconds:g} s or one update each{compiling}")
    build.use_threads(config)
    run = provenance.new_run(config, "bench", scenario=config.scenario.name)
    with run.work() as live:
        speeds = [job() for job in track(jobs, "bench", "speeds")]
        live.update(result={"speeds": [asdict(speed) for speed in speeds]})
    columns = ("what", "mode", "environments", "environment steps/s", "seconds before the first")
    cells = [
        (s.what, s.mode, f"{s.environments:,}", f"{s.steps_per_second:,.0f}", f"{s.first_seconds:.1f}") for s in speeds
    ]
    table(columns, cells, title=f"scenario {config.scenario.name}, {config.engine.threads} thread(s)")
    steps = config.eval.seconds / config.drone.control_period
    say(f"1,000 episodes take about {1000 * steps / speeds[-1].steps_per_second:.0f} s; recorded: {run.path}")
    return speeds


def world_speed(world: WorldSpec, size: int, compiled: bool, seconds: float) -> Speed:
    """The world under random commands, observation and reward vector included, started again every RESTART steps."""
    compiler = Compiler(compiled)
    env = FormationEnv(world).compiled(compiler)
    scenarios = sample(world.scenario, size, seed=0, dtype=env.dtype)
    start = env.reset(scenarios)
    commands = torch.rand((RESTART, size, env.drones, 4), generator=torch.Generator().manual_seed(0)) * 2 - 1
    commands = commands.to(env.dtype)

    def advance(steps: int) -> int:
        state = start
        for command in commands[:steps]:
            env.observe(state, scenarios)
            state, _, _ = env.step(state, command, scenarios)
        return steps * size

    with torch.no_grad():
        begun = time.perf_counter()
        advance(2)
        first = time.perf_counter() - begun
        rate = repeated(lambda: advance(RESTART), seconds)
    return Speed("world", mode(compiled, compiler), size, rate, first)


def learner_speed(config: Config, compiled: bool, seconds: float) -> Speed:
    """Flying and learning together, after two updates that are not counted."""
    trainer = Trainer(one_period(replace(build.training(config), compile=compiled)))
    updates = trainer.train()
    begun = time.perf_counter()
    last = [next(updates), next(updates)][-1].steps
    first = time.perf_counter() - begun

    def update() -> int:
        nonlocal last
        before, last = last, next(updates).steps
        return last - before

    rate = repeated(update, seconds)
    name = f"learner {methods.learners(config)}"
    return Speed(name, mode(compiled, trainer.compiler), config.algo.envs, rate, first)


def evaluation_speed(config: Config, episodes: int) -> Speed:
    """Episodes of the shipped policy, as ``formctl eval`` flies them."""
    method = methods.policy(str(methods.shipped()["mixed"]), config.runs)
    config = method.settings_of(config)
    scene = EvaluationScene(build.world(config), Bank.create(config.scenario, episodes, config.eval.seed))
    begun = time.perf_counter()
    evaluate(method, [scene], config, jobs=workers.cores())
    spent = time.perf_counter() - begun
    steps = episodes * config.eval.seconds / config.drone.control_period
    return Speed(f"evaluation ({workers.cores()} processes)", "eager", config.eval.batch, steps / spent, 0.0)


def one_period(settings: TrainSettings) -> TrainSettings:
    """The training in its own scenario throughout, without an end."""
    return replace(settings, curriculum=CurriculumSpec("bench", (Period("all", 1, {}, "previous"),)), steps=ENDLESS)


def repeated(work: Callable[[], int], seconds: float) -> float:
    """Environment steps per second of ``work`` (it returns how many it did), done for ``seconds`` and at least once."""
    done, begun = 0, time.perf_counter()
    while done == 0 or time.perf_counter() - begun < seconds:
        done += work()
    return done / (time.perf_counter() - begun)


def mode(compiled: bool, compiler: Compiler) -> str:
    """Whether it really was compiled."""
    return "eager" if not compiled else "compiled" if compiler.enabled else "not compiled: no compiler"
