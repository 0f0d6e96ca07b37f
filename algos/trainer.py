"""One training: the periods of a curriculum, a learner in an arena, and a state that resumes bit for bit."""

import random
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch

from algos import curriculum
from algos.arena import Arena
from algos.compilation import Compiler, Listen
from algos.curriculum import CurriculumSpec, Stage
from algos.encoder import EncoderSpec
from algos.learner import Learner, LearnerSpec, Problem, TrainingDiverged
from algos.policy import Policy
from algos.replicas import ALONE, Replicas
from envs.formation import FormationEnv, WorldSpec
from envs.vocabulary import Weights


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

    def __init__(
        self,
        settings: TrainSettings,
        device: torch.device | str = "cpu",
        compiling: Listen = lambda name, ready, pieces: None,
        replicas: Replicas = ALONE,
    ) -> None:
        """`compiling` is called before each piece that is compiled or loaded. `replicas` share the environments.

        Raises ValueError, one line, for settings that cannot be trained.
        """
        _check_weights(settings.weights)
        self.settings, self.device, self.replicas = settings, torch.device(device), replicas
        self.stages = curriculum.plan(settings.curriculum, settings.world.scenario, settings.algo, settings.steps)
        self.room = curriculum.capacity(self.stages)
        self.compiler = Compiler(settings.compile, compiling)
        self.worlds: list[FormationEnv] = []
        self.steps, self.index, self.drawn = 0, 0, 0
        self.learner = self._build_learner()
        self.arena = self._build_arena()

    @property
    def policy(self) -> Policy:
        """The policy being trained; save or evaluate it between updates."""
        return self.learner.policy

    @property
    def stage(self) -> Stage:
        """The period under way and its budget."""
        return self.stages[self.index]

    @property
    def total(self) -> int:
        """Environment steps of the whole training, as far as one can tell where periods may end early."""
        return self.stages[-1].last

    def train(self) -> Iterator[Progress]:
        """Update until the budget is spent. Raises TrainingDiverged; the policy is then that of the last good one."""
        while self.steps < self.total:
            self.replicas.tell("update")
            started = time.perf_counter()
            self._enter()
            stage = self.stage
            try:
                metrics = self.learner.update(self.arena, (self.steps - stage.first) / (stage.last - stage.first))
            except TrainingDiverged as error:
                raise TrainingDiverged({"steps": self.steps, "period": stage.period.name} | error.record) from error
            self.steps += stage.size
            metrics = self.replicas.mean_figures(metrics)
            metrics |= self.arena.metrics(self.replicas.total) | stage.facts(self.drawn)
            metrics["steps_per_second"] = stage.size / (time.perf_counter() - started)
            if self.steps < stage.last and stage.over(self.drawn, metrics):
                self.stages = curriculum.advance(self.stages, self.index, self.steps, self.settings.steps)
                metrics["period/advanced"] = 1.0
            yield Progress(self.steps, self.total, stage.period.name, metrics)

    def warm(self) -> Iterator[str]:
        """Compile what every period needs, by one update of each; yields the periods' names as they get ready.

        Nothing that could be used is learnt: this fills the cache for trainings with the same settings.
        """
        for stage in self.stages:
            self.steps = stage.first
            next(self.train())
            yield stage.period.name

    def begin_from(self, policy: Policy) -> None:
        """Train on from ``policy`` instead of from chance, in every process; before the first update.

        To be called in rank 0. The critic is learnt anew.

        Raises ValueError, one line, where the policy observes or commands something else or is built otherwise.
        """
        policy.check(self._world())
        self.learner.adopt(policy)
        self.replicas.tell([self.state_dict()])

    def _enter(self) -> None:
        """Before an update: step into its period, and draw fresh scenarios when it is time."""
        index = next(index for index, stage in enumerate(self.stages) if self.steps < stage.last)
        if index != self.index:
            self.index, self.drawn = index, 0
            self._pass_on()
            self.arena = self._build_arena()
            return
        drawn = (self.steps - self.stage.first) // self.stage.size // self.stage.algo.pool_updates
        if drawn != self.drawn:
            self.drawn = drawn
            self.arena.refresh(self.stage.law(drawn), self._pool_seed())

    def _pass_on(self) -> None:
        """What was learnt so far into a new period: the same learner goes on, or another one takes over."""
        before = self.learner
        if self.stage.period.start == "scratch":
            self.learner = self._build_learner()
        elif self._algo == before.spec:
            before.start_period()
        else:
            self.learner = self._build_learner()
            self.learner.inherit(before)

    @property
    def _algo(self) -> LearnerSpec:
        """The period's learner with this process's share of the environments."""
        return share(self.stage.algo, self.replicas.size)

    def _build_learner(self) -> Learner:
        learner = self._algo.build(self._problem(), self._seed("learner"), self.compiler)
        if self.replicas.rank:  # the same networks as in rank 0, other noise
            learner.generator.manual_seed(self._seed("noise"))
        return learner

    def _problem(self) -> Problem:
        settings = self.settings
        world, layout = settings.world, self._world().layout
        return Problem(
            settings.encoder,
            layout,
            world.observation,
            world.drone,
            self.room[1],
            settings.weights,
            self.device,
            self.replicas,
        )

    def _build_arena(self) -> Arena:
        algo = self._algo
        return Arena(
            self._world(),
            self.stage.law(self.drawn),
            self.room,
            algo.envs,
            algo.pool,
            self._pool_seed(),
            algo.hits_terminate,
            algo.stagger,
            self.compiler,
        )

    def _world(self) -> FormationEnv:
        """The world of a stage; those that differ only in what is drawn share one, compiled once."""
        world, scenario = self.settings.world, self.stage.scenario
        reward = self.stage.period.reward or world.reward
        for env in self.worlds:
            if curriculum.same_world(env.world.scenario, scenario) and env.world.reward == reward:
                return env
        env = FormationEnv(WorldSpec(scenario, world.drone, world.observation, reward), torch.float32, self.device)
        if self.worlds and env.layout != self.worlds[0].layout:
            raise ValueError(
                f"the periods of curriculum={self.settings.curriculum.name} differ in the number of drones"
            )
        self.worlds.append(env)
        return env

    def _pool_seed(self) -> int:
        return self._seed("pool", self.drawn)

    def _seed(self, purpose: str, counter: int = 0) -> int:
        """A seed of its own for every purpose, period, draw and process; all follow from the training's seed."""
        keys = [self.settings.seed, ("learner", "pool", "noise").index(purpose), self.index, counter]
        if self.replicas.rank and purpose != "learner":
            keys.append(self.replicas.rank)
        return int(np.random.SeedSequence(keys).generate_state(1)[0])

    def state_dict(self) -> dict[str, Any]:
        """Plain containers and tensors: all that is needed to go on as if nothing had happened (CPU: bit for bit)."""
        return {
            "settings": _fingerprint(self.settings),
            "steps": self.steps,
            "plan": [(stage.first, stage.updates) for stage in self.stages],
            "stage": self.index,
            "drawn": self.drawn,
            "learner": self.learner.state_dict(),
            "arena": self.arena.state_dict(),
            "random": _random_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue a training. Raises ValueError when its settings were not these (`compile` may differ)."""
        if difference := _difference(state["settings"], _fingerprint(self.settings)):
            raise ValueError(f"this checkpoint belongs to another training: {difference}")
        self.steps, self.index, self.drawn = state["steps"], state["stage"], state["drawn"]
        self.stages = tuple(
            replace(stage, first=first, updates=updates)
            for stage, (first, updates) in zip(self.stages, state["plan"], strict=True)
        )
        if self._algo != self.learner.spec:
            self.learner = self._build_learner()
        self.learner.load_state_dict(state["learner"])
        self.arena = self._build_arena()
        if state["arena"] is None:  # of another number of processes: episodes begin anew
            self.learner.generator.manual_seed(self._seed("noise", self.steps))
        else:
            self.arena.load_state_dict(state["arena"])
            _restore_random_state(state["random"])

    def states(self) -> list[dict[str, Any]]:
        """`state_dict` of every process, in the order of ranks; to be called in rank 0."""
        self.replicas.tell("save")
        return self.replicas.gather(self.state_dict())

    def load_states(self, states: list[dict[str, Any]]) -> None:
        """Continue in every process from `states()`; to be called in rank 0.

        Those of another number of processes give networks, optimisers and the place in the curriculum; the episodes
        begin anew then. Raises ValueError when the settings were not these.
        """
        self.replicas.tell(states)
        if len(states) == self.replicas.size:
            self.load_state_dict(states[self.replicas.rank])
        else:
            self.load_state_dict(states[0] | {"arena": None})


def follow(replicas: Replicas) -> None:
    """What every process but rank 0 does: train and give its state as rank 0 tells, until it ends the training.

    Raises ReplicaLost when another process is gone.
    """
    while (order := replicas.hear()) != "end":
        if isinstance(order, TrainSettings):
            trainer = Trainer(order, replicas=replicas)
            updates = trainer.train()
        elif order == "update":
            with suppress(TrainingDiverged):  # in all processes alike: rank 0 says so
                next(updates)
        elif order == "save":
            replicas.gather(trainer.state_dict())
        else:
            trainer.load_states(order)


def share(algo: LearnerSpec, processes: int) -> LearnerSpec:
    """The settings of one of several processes that learn together: an equal share of environments and scenarios.

    Raises ValueError where the environments do not divide.
    """
    if processes == 1:
        return algo
    if hasattr(algo, "replay"):
        raise ValueError("a learner that replays collisions keeps one store of them: train.processes=1")
    if algo.envs % processes:
        fitting = [n for n in range(1, algo.envs + 1) if algo.envs % n == 0 and n < 4 * processes]
        raise ValueError(
            f"algo.envs={algo.envs} does not divide into train.processes={processes}: choose one of {fitting}"
        )
    envs = algo.envs // processes
    parts: dict[str, Any] = {"envs": envs, "pool": max(envs, algo.pool // processes)}
    return replace(algo, **parts)  # type: ignore[type-var]


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
    if isinstance(saved, list | tuple) and isinstance(ours, list | tuple) and len(saved) == len(ours):
        pairs = enumerate(zip(saved, ours, strict=True))
        return next(filter(None, (_difference(one, other, f"{key}.{place}") for place, (one, other) in pairs)), None)
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
