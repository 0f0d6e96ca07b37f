"""Stage 2, one policy through the periods of a curriculum (paper, Sec. V-B): what ``formctl train`` does."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from algos.mappo import MappoSpec
from algos.policy import Policy
from algos.trainer import Trainer
from envs.bank import Bank
from envs.vocabulary import Weights
from formctl import budget, processes, store, trackers, training
from formctl.console import duration, progress, say
from formctl.evaluation import methods
from formctl.evaluation.evaluate import evaluate
from formctl.evaluation.rows import selection_score
from formctl.evaluation.scenes import EvaluationScene
from formctl.search.table import split_reference
from formctl.search.winner import newest_winner, resolve_weights
from formctl.settings import Config, build, compose, restore
from formctl.stages import hints
from formctl.store import Run, provenance
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from formctl.training import Judge

FALLBACK = "tuned"
"""Weights of stage 2 where the store has no search of the task."""


def train(overrides: Sequence[str] = ()) -> Run:
    """Train one policy and return its run. Raises ConfigError, StoreError, RunFailed, KeyboardInterrupt."""
    config, origin = compose_training(overrides)
    return execute(config, origin=origin)


def follows_another() -> bool:
    """Whether this is a process of torchrun that another one leads; all its work is done then."""
    replicas = processes.launched() if processes.led() else None
    if replicas is not None:
        processes.serve(replicas)
    return replicas is not None


def compose_training(overrides: Sequence[str]) -> tuple[Config, str]:
    """The settings of a training, and where its weights come from in words.

    A call that names no weights, no experiment and a curriculum of several periods is stage 2 of the paper: it takes
    the winner of the newest finished search of its task, or the weights FALLBACK where the store has none.
    """
    config = compose(overrides, lambda reference: resolved(reference, overrides))
    typed = {word.partition("=")[0].partition(".")[0] for word in overrides}
    if "weights" in typed or config.experiment or len(config.curriculum.periods) < 2:
        return config, str(config.tree["weights"]["name"])
    if winner := newest_winner(config):
        words = [*overrides, f"weights=@{winner.reference}"]
        return compose(words, lambda reference: winner.weights), winner.sentence
    words = [*overrides, f"weights={FALLBACK}"]
    return compose(words), f"{FALLBACK}; no finished search of this task in {config.runs}"


def resolved(reference: str, overrides: Sequence[str]) -> Weights:
    """The weights of ``weights=@STUDY/best``, looked for in the store that the call names."""
    return resolve_weights(reference, compose([word for word in overrides if word.startswith("runs=")]).runs)


def resume(text: str, overrides: Sequence[str] = ()) -> Run:
    """Go on with the training that ``text`` names, with the settings it was begun with.

    Raises StoreError for a run that is done, and for overrides: a training keeps its settings.
    """
    if others := [word for word in overrides if not word.startswith(("runs=", "train.processes="))]:
        raise StoreError(
            f"--resume keeps the run's settings: leave out {' '.join(others)}, or train anew without --resume"
        )
    run = store.resolve(text, compose(overrides).runs, kind="train")
    if run.status == "done":
        raise StoreError(f"{run.path} is done already; its policy is {run.path / 'policy.pt'}")
    tree = run.config
    if chosen := [word for word in overrides if word.startswith("train.processes=")]:
        count = compose(chosen).train.processes
    else:
        count = run.record.get("processes", 1)  # of runs begun before there were several: one
    config = restore(tree | {"train": tree["train"] | {"processes": count}})
    announce(config, steps_done(run))
    fit(run, config)
    return run


def execute(config: Config, parents: tuple[str, ...] = (), origin: str = "", **fields: Any) -> Run:
    """Make a run for ``config``, train, and return the run. ``origin`` says where the weights come from."""
    name = str(config.tree["weights"]["name"])
    if name.startswith("@"):
        parents = (*parents, split_reference(name[1:], config.runs)[0].id)
    trackers.check(config.logger)
    build.training(config)  # settings that contradict each other are refused before a folder is made
    if first := starting_policy(config):
        parents = (*parents, *filter(None, [str(first.facts["run"])]))
        fields |= {"start": {"policy": config.start, "name": first.name, "run": first.facts["run"]}}
    announce(config, 0, origin)
    run = provenance.new_run(
        config,
        "train",
        parents=tuple(dict.fromkeys(parents)),
        scenario=config.scenario.name,
        budget={"steps": config.train.steps},
        **fields,
    )
    fit(run, config)
    return run


def fit(run: Run, config: Config) -> None:
    """Train in ``run`` to the end of the budget, from its checkpoint if it has one."""
    build.use_threads(config)
    facts = methods.facts(config, run.id)
    first = None if run.checkpoint().exists() else starting_policy(config)
    start = steps_done(run)
    say(f"{'going on with' if start else 'run'} {run.path}")
    count, why = processes.chosen(config.train.processes, build.training(config))
    if why:
        say(why)
    with run.work() as live, progress(f"train {config.name}", config.train.steps, "steps", start=start) as bar:
        live.update(method=facts)
        if count > 1:
            bar.preparing(f"starting {count} processes")
        try:
            with processes.replicas(count) as replicas:
                live.update(processes=replicas.size)
                fitted = training.train(
                    live,
                    build.training(config),
                    config.train,
                    meta={"method": facts, "profile": config.profile},
                    judge=judge(config),
                    start=None if first is None else first.policy(),
                    logger=config.logger,
                    listen=lambda done, policy: bar.update(done.steps, note(done.period, done.metrics)),
                    compiling=lambda name, ready, pieces: bar.preparing(f"compiling {name}, {ready} of {pieces} ready"),
                    replicas=replicas,
                )
        except KeyboardInterrupt as stop:
            raise KeyboardInterrupt(f"{stop or 'interrupted'}; {go_on(run)}") from stop
        except (StoreError, processes.ProcessLost) as error:
            raise type(error)(f"{error}; {go_on(run)}") from error
        best = fitted.best
        figures = {key: value for key, value in best.items() if key != "steps"}
        live.update(result={"steps": fitted.steps, "policy_steps": best.get("steps", fitted.steps), **figures})
    kept = f"; CFR {best['cfr']:.2f} on {config.train.judge_episodes} episodes" if best else ""
    say(f"trained {fitted.steps:,} steps in {run.record['minutes']:.1f} min{kept}")
    say(f"policy: {run.path / 'policy.pt'}")
    say(f"fly it: formctl eval --policy {hints.typed(run)}")


def starting_policy(config: Config) -> methods.Method | None:
    """The policy that ``start=`` names; None where a training starts from chance. Raises ValueError, one line."""
    if not config.start:
        return None
    method = methods.policy(config.start, config.runs)
    if method.trained is None:
        raise ValueError(f"start={config.start}: only policies that formctl train has written can be trained on")
    Trainer(replace(build.training(config), compile=False)).begin_from(method.policy())
    return method


def go_on(run: Run) -> str:
    """How to go on with a training that stopped."""
    return f"go on with: formctl train --resume {hints.typed(run)}"


def steps_done(run: Run) -> int:
    """Steps in the latest checkpoint, as the metrics file knows them; 0 without a checkpoint."""
    rows = run.metrics() if run.checkpoint().exists() else []
    return int(rows[-1]["steps"]) if rows else 0


def announce(config: Config, start: int, origin: str = "") -> None:
    """Say what is trained and what the steps after ``start`` need. Raises StoreError when the disk is too small."""
    if isinstance(config.algo, MappoSpec) and getattr(config.reward, "failure", None) == 0:
        say("this reward takes nothing for a hit, which MAPPO learns most from: reward=shaped does")
    for line in described(config, origin):
        say(line)
    left = config.train.steps - start
    minutes = budget.training_minutes(config, left)
    about = f", about {duration(60 * minutes)} as earlier trainings here went" if minutes else ""
    say(f"about to spend {left:,} steps{about}: {budget.room(3 * budget.CHECKPOINT, config.runs)}")


def described(config: Config, origin: str = "") -> list[str]:
    """What a training is made of: learner, reward, weights and where they come from, observation, curriculum."""
    formation, flight, obstacle, action = config.weights
    vector = f"formation {formation:.2f}, flight {flight:.2f}, obstacle {obstacle:.2f}, action {action:.2f}"
    reward = config.tree["reward"].get("name") or type(config.reward).__name__
    periods = ", ".join(period.name for period in config.curriculum.periods)
    return [
        f"learner {methods.learners(config)}, reward {reward}, observation {config.observation.name},"
        f" encoder {config.encoder.name}",
        f"weights: {origin or config.tree['weights']['name']} ({vector})",
        f"curriculum {config.curriculum.name}: {periods}",
    ]


def judge(config: Config) -> "Judge":
    """The small evaluation that chooses which policy is kept: the configured scenario, held-out episodes."""
    bank = Bank.create(config.scenario, config.train.judge_episodes, build.held_out_seed(config.seed, "judge"))
    scene = EvaluationScene(build.world(config), bank)
    config = replace(config, sim="torch")

    def score(policy: Policy) -> dict[str, float]:
        return selection_score(evaluate(methods.in_memory("judged", config.seed, policy), [scene], config))

    return score


def note(period: str, metrics: dict[str, float]) -> str:
    """How the training goes, in a few words for the progress line."""
    free, fm = metrics.get("train/collision_free"), metrics.get("train/fm")
    figures = [] if free is None or fm is None else [f"collision-free {free:.2f}", f"FM {fm:.2f}"]
    return ", ".join([period, *figures])
