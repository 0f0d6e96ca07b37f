"""``formctl search``: stage 1, a policy for each of many random weight vectors, and how often each satisfies.

Paper, Sec. IV-B1. ``--trials`` is the total of the study: the same command again finishes what is missing.
"""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from formctl.options import Overrides, ShowConfig, configs

if TYPE_CHECKING:
    from sqlalchemy import URL

    from formctl.config import Config
    from formctl.store import Run
    from formctl.study import Study

SHARED = ("drone", "observation", "reward", "encoder", "algo", "eval", "sim")
"""Groups that all trials of a study have in common, beside the search's own scenario and budgets."""


def command(
    overrides: Overrides = None,
    trials: Annotated[int | None, typer.Option(help="Total number of trials in the study, not more trials.")] = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Try failed trials once more.")] = False,
    status: Annotated[bool, typer.Option("--status", help="Show how far the study is and stop.")] = False,
    best: Annotated[bool, typer.Option("--best", help="Show the best trial, flown on fresh episodes.")] = False,
    top: Annotated[int | None, typer.Option(min=1, metavar="N", help="Show the N best trials and stop.")] = None,
    sensitivity: Annotated[
        bool, typer.Option("--sensitivity", help="Show SR and the winner as the objectives' thresholds move, and stop.")
    ] = False,
    dashboard: Annotated[
        bool, typer.Option("--dashboard", help="Show a copy of the study in optuna-dashboard until Ctrl-C.")
    ] = False,
    storage: Annotated[
        str | None, typer.Option(metavar="URL", help="Share the study: postgresql://USER:PASSWORD@HOST/DATABASE.")
    ] = None,
    worker: Annotated[
        str | None, typer.Option(metavar="STUDY", help="Work for a study of --storage that another host began.")
    ] = None,
    cfg: ShowConfig = False,
) -> None:
    """Stage 1: random reward weights, a policy per weight vector, satisfaction rates in a study store."""
    words = [*(overrides or []), *([] if trials is None else [f"search.trials={trials}"])]
    if worker is not None:
        from formctl.joining import join

        join(worker, words, storage)
    elif status or top or sensitivity or dashboard or best:
        show(words, storage, {"top": top, "sensitivity": sensitivity, "dashboard": dashboard, "best": best}, trials)
    else:
        begin(words, storage, cfg, retry_failed)


def begin(words: list[str], address: str | None, cfg: bool, retry: bool) -> None:
    """Bring the study of a call to its total and say how it stands."""
    from formctl.choosing import show_status

    (config,) = configs(words, show=cfg)
    from formctl import storage

    name = study_name(config, words)
    url = storage.given(address)
    run, study = execute(config, name, url=url, retry=retry)
    show_status(name, run, study.ledger, config.search.trials)


def show(words: list[str], address: str | None, asked: dict[str, Any], trials: int | None) -> None:
    """Answer a question about a study that is there."""
    from formctl import choosing

    name, run, ledger = choosing.find(words, address)
    if asked["top"]:
        choosing.show_top(ledger, asked["top"])
    elif asked["dashboard"]:
        from formctl.dashboard import serve

        serve(ledger)
    elif asked["sensitivity"]:
        from formctl.sensitivity import show as show_sensitivity

        show_sensitivity(here(name, run), ledger)
    elif asked["best"]:
        show_winner(name, here(name, run), ledger)
    else:
        choosing.show_status(name, run, ledger, trials)


def here(name: str, run: "Run | None") -> "Run":
    """The study's run folder. Raises StoreError where it is on other hosts only."""
    from formctl.files import StoreError

    if run is None:
        raise StoreError(f"the policies of {name} are not on this host; --status and --top work everywhere")
    return run


def show_winner(name: str, run: "Run", ledger: "Any") -> None:
    """The best trial, flown on the fresh bank unless that is known. Raises StoreError when none is done."""
    from formctl import choosing, overview
    from formctl.files import StoreError
    from formctl.study import Study

    rows = overview.top(ledger, 1)
    if not rows:
        raise StoreError("no trial of the study is done yet; `formctl search --status` shows how far it is")
    if rows[0].get("sr_fresh") is None:
        from formctl.config import restore
        from formctl.trial import settings

        config = restore(run.config)
        choosing.confirm(Study(run.path, ledger), restore(settings(config, name, 0, config.weights)))
        rows = overview.top(ledger, 1)
    choosing.show_best(name, rows[0])


def study_name(config: "Config", overrides: list[str]) -> str:
    """The name the user gave, or the search's own: ``stage1``."""
    given = any(text.startswith("name=") for text in overrides)
    return config.name if given else config.search.name


def execute(
    config: "Config", name: str, parents: tuple[str, ...] = (), url: "URL | None" = None, retry: bool = False
) -> "tuple[Run, Study]":
    """Bring the study ``name`` to its total; returns its run and itself.

    Raises StoreError when the study of that name has other settings; RunFailed when no trial can be finished.
    """
    from formctl import build, choosing
    from formctl.config import restore
    from formctl.console import say
    from formctl.trial import settings

    total = config.search.trials
    first = restore(settings(config, name, 0, config.weights))
    build.training(first)  # settings that contradict each other are refused before a folder is made
    run, study = open_study(config, name, parents, url)
    if study.missing(total) or (retry and study.counts()["failed"]):
        with run.work() as live:
            live.update(budget=live.record["budget"] | {"trials": total})
            finish(config, first, live, study, retry)
            refuse_barren(run, study)
            choosing.confirm(study, first)
            live.update(result=summary(study))
    else:
        say(f"study {name}: all {total} trials are there already")
        refuse_barren(run, study)
        choosing.confirm(study, first)
    return run, study


def finish(config: "Config", first: "Config", live: "Run", study: "Study", retry: bool) -> None:
    """Run the trials that are missing; ``first`` is the configuration of one of them."""
    from formctl import searching
    from formctl.console import say

    total = config.search.trials
    if study.ledger.url.drivername == "sqlite":  # its one owner is here: whoever had a lease is gone
        study.take_over()
    study.ledger.note_study({"trials": total})
    if retry:
        say(f"failed trials to try once more: {study.ledger.retry_failed(total)}")
    announce(config, first, live, study)
    searching.work(study, live, config, total, lambda: live.update(result=summary(study)))


def refuse_barren(run: "Run", study: "Study") -> None:
    """Raise RunFailed when every trial failed: there is nothing to choose from."""
    from formctl.errors import RunFailed

    if not study.counts()["done"]:
        raise RunFailed(f"all {study.counts()['failed']} trials failed; their reasons: {run.path / 'trials.parquet'}")


def open_study(config: "Config", name: str, parents: tuple[str, ...], url: "URL | None") -> "tuple[Run, Study]":
    """The study ``name``, continued or made, with its fixed evaluation bank."""
    from envs.metrics import METRIC_VERSION
    from formctl import choosing, evaluation, provenance, store
    from formctl import storage as addresses
    from formctl.build import held_out_seed
    from formctl.study import Study

    settings = {group: config.tree[group] for group in SHARED}
    settings["search"] = {key: config.tree["search"][key] for key in ("scenario", "steps", "episodes")}
    settings["metric_version"] = METRIC_VERSION
    lease = 60 * config.search.lease_minutes
    run = store.latest(config.runs, "search", name)
    if run is not None and begun(run, name, url):
        study = Study(run.path, choosing.ledger(run, url), lease)
        study.refuse_other(settings, seed=config.seed, rule=config.search.sampler)
        return run, study
    refuse_taken(name, url)
    budget = {"trials": config.search.trials, "steps": config.search.steps, "episodes": config.search.episodes}
    shared: dict[str, Any] = {} if url is None else {"storage": addresses.shown(url)}
    scenario = config.search.scenario.name
    run = provenance.new_run(config, "search", name, parents=parents, scenario=scenario, budget=budget, **shared)
    seed = held_out_seed(config.seed, "search")
    bank = evaluation.save_bank(run.path / "bank.npz", config.search.scenario, config.search.episodes, seed)
    run.update(bank=evaluation.facts(bank))
    facts = {"config": config.tree, "run": run.id, "bank": bank.sha256, "trials": config.search.trials}
    rule = config.search.sampler
    study = Study.create(run.path, seed=config.seed, rule=rule, settings=settings, url=url, name=name, **facts)
    study.lease = lease
    return run, study


def begun(run: "Run", name: str, url: "URL | None") -> bool:
    """Whether the run has its study already: a crash may have come between the two."""
    from formctl.study import known

    if run.record.get("storage"):
        return url is None or name in known(url)
    return (run.path / "study.db").exists()


def refuse_taken(name: str, url: "URL | None") -> None:
    """Reach the shared database before anything is made here, and raise StoreError when it has a study of that name."""
    from formctl import storage
    from formctl.files import StoreError
    from formctl.study import known

    if url is not None and name in known(url):
        raise StoreError(
            f"{storage.shown(url)} has a study {name} that was begun elsewhere: join it with "
            f"formctl search --worker {name}, or type name=NAME for a new one"
        )


def announce(config: "Config", first: "Config", run: "Run", study: "Study") -> None:
    """Say what is there, what is missing and what it will cost."""
    from formctl import build, spending
    from formctl.console import say

    total, missing = config.search.trials, study.missing(config.search.trials)
    say(f"study {run.path}: {total - missing} of {total} done, {missing} to go")
    build.use_threads(config)
    calibration = spending.calibrate(build.training(first))
    seconds = spending.training_seconds(calibration, config.search.steps)
    seconds += spending.flying_seconds(first, config.search.episodes)
    seconds *= -(-missing // config.engine.jobs)
    seconds += spending.flying_seconds(first, config.search.fresh_episodes)
    cost = spending.sentence(seconds, missing * 3 * calibration.bytes, config.runs, compiled=config.train.compile)
    side = f", {config.engine.jobs} side by side" if config.engine.jobs > 1 else ""
    spent = f"{missing} x {config.search.steps:,} steps and {config.search.episodes} episodes each{side}"
    say(f"about to spend {spent}: {cost}")


def summary(study: "Study") -> dict[str, Any]:
    """Counts and the best trial so far, for the run's record."""
    from formctl import overview
    from formctl.choosing import OBJECTIVES

    counts, rows = overview.counts(study.ledger), overview.top(study.ledger, 1)
    if not rows:
        return {**counts, "trial": None, "sr": None, "weights": None}
    row = rows[0]
    rates = {key: row[key] for key in ("sr", "sr_fresh") if row.get(key) is not None}
    return {**counts, "trial": row["trial"], **rates, "weights": [row[f"w_{name}"] for name in OBJECTIVES]}
