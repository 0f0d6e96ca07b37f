"""One training: the periods of a curriculum, a learner in an arena, and a state that resumes bit for bit."""

import random
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch

from algos import curriculum
from algos.arena import Arena
from algos.compilation import Compiler
from algos.curriculum import CurriculumSpec, Stage
from algos.encoder import EncoderSpec
from algos.learner import Learner, LearnerSpec, Problem, TrainingDiverged, Weights
from algos.policy import Policy
from envs.formation import FormationEnv, WorldSpec
from envs.spec import ScenarioSpec


@dataclass(frozen=True)
class TrainSettings:
    """Everything that decides a training; the same settings give the same policy on the same machine."""

    world: WorldSpec
    weights: Weights  # of formation, flight, obstacle, action; they sum to 1
    encoder: EncoderSpec
    algo: LearnerSpec
    curriculum: CurriculumSpec
    steps: int  # environment steps, one step moving all drones of one environment; all periods together
    seed: int
    compile: bool  # torch.compile world and networks


@dataclass(frozen=True)
class Progress:
    """One update done."""

    steps: int  # environment steps so far
    total: int  # environment steps of the whole training, rounded down to whole updates
    period: str
    metrics: dict[str, float]


class Trainer:
    """Trains a policy; one update per item of `train()`, after each of which `state_dict()` may be saved.

    One thread per process is fastest on these small networks (`torch.set_num_threads(1)` or OMP_NUM_THREADS=1); two
    trainings side by side use two cores better than one training does. Resuming is bit for bit at one thread: with
    several, the mathematics libraries may split their sums by how busy the machine is.
    """

    def __init__(self, settings: TrainSettings, device: torch.device | str = "cpu") -> None:
        """Raises ValueError, one line, for settings that cannot be trained."""
        _check_weights(settings.weights)
        self.settings, self.device = settings, torch.device(device)
        self.steps_per_update = settings.algo.envs * settings.algo.rollout
        self.stages = curriculum.plan(
            settings.curriculum, settings.world.scenario, settings.steps, self.steps_per_update
        )
        self.room = curriculum.capacity(self.stages)
        self.compiler = Compiler(settings.compile)
        self.worlds: list[FormationEnv] = []
        self.update, self.drawn = 0, 0
        self.stage = self.stages[0]
        self.learner = self._build_learner(self.stage)
        self.arena = self._build_arena(self.stage)

    @property
    def policy(self) -> Policy:
        """The policy being trained; save or evaluate it between updates."""
        return self.learner.policy

    @property
    def total(self) -> int:
        """Environment steps of the whole training."""
        return self.stages[-1].last * self.steps_per_update

    def train(self) -> Iterator[Progress]:
        """Update until the budget is spent. Raises TrainingDiverged; the policy is then that of the last good one."""
        while self.update < self.stages[-1].last:
            started = time.perf_counter()
            self._enter()
            first, last = self.stage.first, self.stage.last
            try:
                metrics = self.learner.update(self.arena, (self.update - first) / (last - first))
            except TrainingDiverged as error:
                where = {"steps": self.update * self.steps_per_update, "period": self.stage.period.name}
                raise TrainingDiverged(where | error.record) from error
            self.update += 1
            metrics |= self.arena.metrics()
            metrics["steps_per_second"] = self.steps_per_update / (time.perf_counter() - started)
            yield Progress(self.update * self.steps_per_update, self.total, self.stage.period.name, metrics)

    def _enter(self) -> None:
        """Before an update: step into its period, and draw fresh scenarios when it is time."""
        stage = next(stage for stage in self.stages if self.update < stage.last)
        if stage is not self.stage:
            self.stage, self.drawn = stage, 0
            if stage.period.start == "scratch":
                self.learner = self._build_learner(stage)
            else:
                self.learner.start_period()
            self.arena = self._build_arena(stage)
        elif (drawn := (self.update - stage.first) // self.settings.algo.pool_updates) != self.drawn:
            self.drawn = drawn
            self.arena.refresh(self._pool_seed())

    def _build_learner(self, stage: Stage) -> Learner:
        world = self.settings.world
        problem = Problem(
            self.settings.encoder,
            self._world(stage.scenario).layout,
            world.observation,
            world.drone,
            self.room[1],
            self.settings.weights,
            self.device,
        )
        return self.settings.algo.build(problem, self._seed("learner", stage), self.compiler)

    def _build_arena(self, stage: Stage) -> Arena:
        algo = self.settings.algo
        return Arena(
            self._world(stage.scenario),
            stage.scenario,
            self.room,
            algo.envs,
            algo.pool,
            self._pool_seed(),
            algo.hits_terminate,
            algo.stagger,
            self.compiler,
        )

    def _world(self, scenario: ScenarioSpec) -> FormationEnv:
        """The world of a scenario; scenarios that differ only in what is drawn share one, compiled once."""
        for env in self.worlds:
            if curriculum.same_world(env.world.scenario, scenario):
                return env
        world = self.settings.world
        env = FormationEnv(
            WorldSpec(scenario, world.drone, world.observation, world.reward), torch.float32, self.device
        )
        if self.worlds and env.layout != self.worlds[0].layout:
            raise ValueError(
                f"the periods of curriculum={self.settings.curriculum.name} differ in the number of drones"
            )
        self.worlds.append(env)
        return env

    def _pool_seed(self) -> int:
        return self._seed("pool", self.stage, self.drawn)

    def _seed(self, purpose: str, stage: Stage, counter: int = 0) -> int:
        """A seed of its own for every purpose, period and draw; all follow from the training's seed."""
        keys = [self.settings.seed, ("learner", "pool").index(purpose), self.stages.index(stage), counter]
        return int(np.random.SeedSequence(keys).generate_state(1)[0])

    def state_dict(self) -> dict[str, Any]:
        """Plain containers and tensors: all that is needed to go on as if nothing had happened (CPU: bit for bit)."""
        return {
            "settings": _fingerprint(self.settings),
            "update": self.update,
            "stage": self.stages.index(self.stage),
            "drawn": self.drawn,
            "learner": self.learner.state_dict(),
            "arena": self.arena.state_dict(),
            "random": _random_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue a training. Raises ValueError when its settings were not these (`compile` may differ)."""
        if difference := _difference(state["settings"], _fingerprint(self.settings)):
            raise ValueError(f"this checkpoint belongs to another training: {difference}")
        self.update, self.drawn = state["update"], state["drawn"]
        self.stage = self.stages[state["stage"]]
        self.learner.load_state_dict(state["learner"])
        self.arena = self._build_arena(self.stage)
        self.arena.load_state_dict(state["arena"])
        _restore_random_state(state["random"])


def _check_weights(weights: Weights) -> None:
    if len(weights) != 4 or min(weights) < 0 or abs(sum(weights) - 1) > 1e-6:
        raise ValueError(f"weights {tuple(weights)} have to be four numbers >= 0 that sum to 1")


def _fingerprint(settings: TrainSettings) -> dict[str, Any]:
    """The settings as plain data, without those that do not change the result."""
    plain = asdict(settings)
    del plain["compile"]
    return plain


def _difference(saved: Any, ours: Any, key: str = "") -> str | None:
    """The first key in which two settings differ, in words."""
    if isinstance(saved, dict) and isinstance(ours, dict) and saved.keys() == ours.keys():
        for name in ours:
            if found := _difference(saved[name], ours[name], f"{key}.{name}" if key else name):
                return found
        return None
    return None if saved == ours else f"{key} was {saved!r}, now it is {ours!r}"


def _random_state() -> dict[str, Any]:
    """The global generators. The trainer draws from its own; these are kept for whatever runs beside it."""
    kind, keys, *rest = np.random.get_state()
    return {
        "python": random.getstate(),
        "numpy": (kind, torch.from_numpy(np.asarray(keys).astype(np.int64)), *rest),
        "torch": torch.get_rng_state(),
    }


def _restore_random_state(state: dict[str, Any]) -> None:
    random.setstate(state["python"])
    kind, keys, *rest = state["numpy"]
    np.random.set_state((kind, keys.numpy().astype(np.uint32), *rest))
    torch.set_rng_state(state["torch"])
