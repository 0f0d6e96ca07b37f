"""``formctl train``: stage 2, one policy through the periods of a curriculum (paper, Sec. IV-B2)."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from formctl.commands.options import Multirun, Overrides, ShowConfig, configs

if TYPE_CHECKING:
    from algos.policy import Policy
    from envs.vocabulary import Weights
    from formctl.settings import Config
    from formctl.store import Run
    from formctl.training import Judge


def command(
    overrides: Overrides = None,
    resume: Annotated[
        str | None, typer.Option(metavar="RUN", help="Go on with a training: path, id or name of its run.")
    ] = None,
    multirun: Multirun = False,
    cfg: ShowConfig = False,
) -> None:
    """Stage 2: one policy through the periods of the curriculum, e.g. curriculum=three_period encoder=no_sa seed=3."""
    if resume is not None:
        continue_run(resume, overrides or [])
        return
    for config in configs(overrides, multirun, cfg, resolver(overrides or [])):
        execute(config)


def resolver(overrides: list[str]) -> "Any":
    """The function that turns ``weights=@STUDY/best`` into weights, looking in the store that the call names."""

    def resolve(reference: str) -> "Weights":
        from formctl.search.trials import resolve_weights
        from formctl.settings import compose

        return resolve_weights(reference, compose([text for text in overrides if text.startswith("runs=")]).runs)

    return resolve


def continue_run(text: str, overrides: list[str]) -> "Run":
    """Go on with the training that ``text`` names, with the settings it was begun with.

    Raises StoreError for a run that is done, and for overrides: a training keeps its settings.
    """
    from formctl import store
    from formctl.settings import compose, restore
    from formctl.store.files import StoreError

    others = [word for word in overrides if not word.startswith("runs=")]
    if others:
        raise StoreError(
            f"--resume keeps the run's settings: leave out {' '.join(others)}, or train anew without --resume"
        )
    run = store.resolve(text, compose(overrides).runs, kind="train")
    if run.status == "done":
        raise StoreError(f"{run.path} is done already; its policy is {run.path / 'policy.pt'}")
    config = restore(run.config)
    announce(config, steps_done(run))
    fit_run(run, config)
    return run


def execute(config: "Config", parents: tuple[str, ...] = (), **fields: Any) -> "Run":
    """Make a run for ``config``, train, and return the run."""
    from formctl.search.trials import split_reference
    from formctl.settings import build
    from formctl.store import provenance

    name = str(config.tree["weights"]["name"])
    if name.startswith("@"):
        parents = (*parents, split_reference(name[1:], config.runs)[0].id)
    build.training(config)  # settings that contradict each other are refused before a folder is made
    announce(config, 0)
    run = provenance.new_run(
        config,
        "train",
        parents=tuple(dict.fromkeys(parents)),
        scenario=config.scenario.name,
        budget={"steps": config.train.steps},
        **fields,
    )
    fit_run(run, config)
    return run


def fit_run(run: "Run", config: "Config") -> None:
    """Train in ``run`` to the end of the budget, from its checkpoint if it has one."""
    from formctl import training
    from formctl.console import progress, say
    from formctl.flying import methods
    from formctl.settings import build
    from formctl.store.files import StoreError

    build.use_threads(config)
    facts = methods.facts(config, run.id)
    start = steps_done(run)
    say(f"{'going on with' if start else 'run'} {run.path}")
    with run.work() as live, progress(f"train {config.name}", config.train.steps, "steps", start=start) as bar:
        live.update(method=facts)
        try:
            fit = training.train(
                live,
                build.training(config),
                config.train,
                meta={"method": facts, "profile": config.profile},
                judge=judge(config),
                tensorboard=config.logger.tensorboard,
                listen=lambda done, policy: bar.update(done.steps, describe(done.period, done.metrics)),
                compiling=lambda name, ready, pieces: bar.preparing(f"compiling {name}, {ready} of {pieces} ready"),
            )
        except KeyboardInterrupt as stop:
            raise KeyboardInterrupt(f"{stop or 'interrupted'}; go on with: formctl train --resume {run.id}") from stop
        except StoreError as error:
            raise StoreError(f"{error}; go on with: formctl train --resume {run.id}") from error
        live.update(result={"steps": fit.steps, "policy_steps": fit.best.get("steps", fit.steps), **figures(fit.best)})
    best = f"; CFR {fit.best['cfr']:.2f} on {config.train.judge_episodes} episodes" if fit.best else ""
    say(f"trained {fit.steps:,} steps in {run.record['minutes']:.1f} min{best}")
    say(f"policy: {run.path / 'policy.pt'}")
    say(f"fly it: formctl eval --policy {run.id}")


def figures(best: dict[str, Any]) -> dict[str, Any]:
    """What the judgement of the kept policy said."""
    return {key: value for key, value in best.items() if key != "steps"}


def steps_done(run: "Run") -> int:
    """Steps in the latest checkpoint, as the metrics file knows them; 0 without a checkpoint."""
    rows = run.metrics() if run.checkpoint().exists() else []
    return int(rows[-1]["steps"]) if rows else 0


def announce(config: "Config", start: int) -> None:
    """Say what is about to be spent on the steps after ``start``. Raises StoreError when the disk is too small."""
    from algos.mappo import MappoSpec
    from formctl import spending
    from formctl.console import say
    from formctl.settings import build

    if isinstance(config.algo, MappoSpec) and getattr(config.reward, "failure", None) == 0:
        say("this reward takes nothing for a hit, which MAPPO learns most from: reward=shaped does")
    build.use_threads(config)
    calibration = spending.calibrate(build.training(config))
    left = config.train.steps - start
    judgements = left // config.train.judge_steps + 1
    seconds = spending.training_seconds(calibration, left)
    seconds += judgements * spending.flying_seconds(config, config.train.judge_episodes)
    cost = spending.sentence(seconds, 3 * calibration.bytes, config.runs, compiled=config.train.compile)
    periods = ", ".join(period.name for period in config.curriculum.periods)
    say(f"about to spend {left:,} steps (curriculum {config.curriculum.name}: {periods}): {cost}")


def judge(config: "Config") -> "Judge":
    """The small evaluation that chooses which policy is kept: the configured scenario, held-out episodes."""
    from dataclasses import replace

    from envs.bank import Bank
    from formctl.flying import evaluation, methods
    from formctl.settings import build

    seed = build.held_out_seed(config.seed, "judge")
    bank = Bank.create(config.scenario, config.train.judge_episodes, seed)
    scene = evaluation.Scene(build.world(config), bank)
    config = replace(config, sim="torch")

    def score(policy: "Policy") -> dict[str, float]:
        facts = {"name": "judged", "seed": config.seed, "run": ""}
        flown = methods.Method(facts, "", (), lambda env: methods.PolicyAgent("judged", policy, env))
        return evaluation.score(evaluation.fly(flown, [scene], config))

    return score


def describe(period: str, metrics: dict[str, float]) -> str:
    """How the training goes, in a few words for the progress line."""
    free, fm = metrics.get("train/collision_free"), metrics.get("train/fm")
    figures = [] if free is None or fm is None else [f"collision-free {free:.2f}", f"FM {fm:.2f}"]
    return ", ".join([period, *figures])
