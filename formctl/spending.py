"""What a command is about to spend, said before it is spent: steps, minutes from a short calibration, disk."""

import math
import shutil
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from algos import curriculum
from algos.curriculum import CurriculumSpec, Period
from algos.trainer import Trainer, TrainSettings
from envs.flight import fly
from envs.scenarios import sample
from envs.spec import Scenarios, State
from formctl.console import duration
from formctl.flying.flights import flock, together
from formctl.settings.build import environment, world
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from formctl.flying.methods import Method
    from formctl.settings import Config

SECONDS = 5.0
"""Length of a calibration."""

FLOWN = 10
"""Steps that an evaluation is timed on."""

ALONE = 75
"""The same for what thinks for one episode at a time."""


@dataclass(frozen=True)
class Calibration:
    """What a training costs on this machine."""

    steps_per_second: float  # without compiling: compiled trainings pass it after their first minutes
    bytes: int  # of one checkpoint


_known: dict[str, Calibration] = {}


def calibrate(settings: TrainSettings, seconds: float = SECONDS) -> Calibration:
    """Train for ``seconds`` with short roll-outs, as many environments as planned, nothing compiled.

    A training that is smaller than that is not worth five seconds: its own number of steps ends the calibration too.
    Every learner of the curriculum is calibrated, once per process, and counts with the steps it is given.
    """
    stages = curriculum.plan(settings.curriculum, settings.world.scenario, settings.algo, settings.steps)
    found = []
    for stage in stages:
        key = repr((stage.algo, settings.encoder))
        if key not in _known:
            period = Period("calibration", 1, asdict(stage.law(stage.draws - 1)), "previous")
            only = CurriculumSpec("calibration", (period,))
            _known[key] = _measure(replace(settings, algo=stage.algo, curriculum=only), seconds)
        found.append((stage.last - stage.first, _known[key]))
    spent = sum(steps / calibration.steps_per_second for steps, calibration in found)
    return Calibration(sum(steps for steps, _ in found) / spent, max(calibration.bytes for _, calibration in found))


def _measure(settings: TrainSettings, seconds: float) -> Calibration:
    algo: Any = settings.algo
    short = replace(algo, rollout=min(algo.rollout, 4), pool=min(algo.pool, algo.envs))
    trainer = Trainer(replace(settings, algo=short, steps=1000 * short.envs * short.rollout, compile=False))
    updates = trainer.train()
    first = next(updates)  # the first update pays for what is only done once
    begun = time.perf_counter()
    last = first
    while last is first or (time.perf_counter() - begun < seconds and last.steps < settings.steps):
        last = next(updates)
    rate = (last.steps - first.steps) / (time.perf_counter() - begun)
    return Calibration(rate, size(trainer.state_dict()))


def flying_seconds(config: "Config", episodes: int, method: "Method | None" = None, jobs: int = 1) -> float:
    """Seconds that an evaluation of ``episodes`` takes, from a few steps of its first batch.

    Without a ``method`` the drones hover, which costs about what a policy does. What thinks for one episode at a time
    is timed for longer, because its steps differ, and shared by ``jobs``.
    """
    task = world(config)
    env = environment(method.fit(task) if method else task, config.sim)
    agent = method.make(env) if method else None
    batched = agent is None or agent.capabilities.batched
    batch, steps = min(episodes, config.eval.batch), FLOWN
    if method and agent and not batched:
        batch, steps = flock(agent, episodes, jobs), ALONE
        agent = together([method.make(env) for _ in range(batch)])
    scenarios = sample(config.scenario, batch, seed=0, dtype=env.dtype)
    seconds = 0.0
    for flown in (min(steps, FLOWN), steps):  # the first pays for what is only done once
        if agent is not None:
            agent.reset(scenarios, env.reset(scenarios))
        begun = time.perf_counter()
        fly(env, agent.act if agent else hold, scenarios, replace(config.eval, seconds=flown * env.dt))
        seconds = (time.perf_counter() - begun) / flown
    flights = math.ceil(math.ceil(episodes / batch) / jobs)
    return seconds * config.eval.seconds / env.dt * flights


def hold(state: State, scenarios: Scenarios) -> torch.Tensor:
    """The first command, hover, for ever."""
    return state.command


def size(content: Any) -> int:
    """Bytes of the tensors in nested containers."""
    if isinstance(content, torch.Tensor):
        return content.numel() * content.element_size()
    if isinstance(content, dict):
        return sum(size(item) for item in content.values())
    return sum(size(item) for item in content) if isinstance(content, list | tuple) else 0


def training_seconds(calibration: Calibration, steps: int) -> float:
    """Seconds that ``steps`` take at the calibrated rate."""
    return steps / calibration.steps_per_second


def sentence(seconds: float, needed: int, root: Path, *, compiled: bool) -> str:
    """``about 4 min, 12 MB of the 80 GB free in runs``. Raises StoreError when the disk is too small for it."""
    free = shutil.disk_usage(existing(root)).free
    if needed > free:
        raise StoreError(
            f"{root} has {readable(free)} left, {readable(needed)} are needed: make room or type runs=FOLDER"
        )
    about = "at most about" if compiled else "about"
    return f"{about} {duration(seconds)}, {readable(needed)} of the {readable(free)} free in {root}"


def existing(path: Path) -> Path:
    """The nearest folder above ``path`` that is there already."""
    path = path.absolute()
    while not path.exists():
        path = path.parent
    return path


def readable(amount: float) -> str:
    """Bytes in the largest unit that leaves a number of at least one."""
    for unit in ("B", "kB", "MB", "GB"):
        if amount < 1000:
            return f"{amount:.0f} {unit}"
        amount /= 1000
    return f"{amount:.1f} TB"
