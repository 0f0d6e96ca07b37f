"""A study on the host that owns it: made or continued, brought to its total, its winner flown once more."""

from typing import Any

from sqlalchemy import URL

from envs.vocabulary import METRIC_VERSION, OBJECTIVES
from formctl import budget, store
from formctl.console import duration, say
from formctl.errors import RunFailed
from formctl.evaluation import scenes
from formctl.search import choosing, overview, sitting, storage
from formctl.search.study import Study, known
from formctl.search.trial import settings
from formctl.settings import Config, build, restore
from formctl.store import Run, provenance
from formctl.store.files import StoreError

SHARED = ("drone", "observation", "reward", "encoder", "algo", "eval", "sim")
"""Groups that all trials of a study have in common, beside the search's own scenario and budgets."""


def execute(
    config: Config, name: str, parents: tuple[str, ...] = (), url: URL | None = None, retry: bool = False
) -> tuple[Run, Study]:
    """Bring the study ``name`` to its total; returns its run and itself.

    Raises StoreError when the study of that name has other settings; RunFailed when no trial can be finished.
    """
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


def finish(config: Config, first: Config, live: Run, study: Study, retry: bool) -> None:
    """Run the trials that are missing; ``first`` is the configuration of one of them."""
    total = config.search.trials
    if study.ledger.url.drivername == "sqlite":  # its one owner is here: whoever had a lease is gone
        study.take_over()
    study.ledger.note_study({"trials": total})
    if retry:
        say(f"failed trials to try once more: {study.ledger.retry_failed(total)}")
    announce(config, first, live, study)
    sitting.work(study, live, config, total, lambda: live.update(result=summary(study)))


def refuse_barren(run: Run, study: Study) -> None:
    """Raise RunFailed when every trial failed: there is nothing to choose from."""
    if not study.counts()["done"]:
        raise RunFailed(f"all {study.counts()['failed']} trials failed; their reasons: {run.path / 'trials.parquet'}")


def open_study(config: Config, name: str, parents: tuple[str, ...], url: URL | None) -> tuple[Run, Study]:
    """The study ``name``, continued or made, with its fixed evaluation bank."""
    common = {group: config.tree[group] for group in SHARED}
    common["search"] = {key: config.tree["search"][key] for key in ("scenario", "steps", "episodes")}
    common["metric_version"] = METRIC_VERSION
    lease = 60 * config.search.lease_minutes
    run = store.latest(config.runs, "search", name)
    if run is not None and begun(run, name, url):
        study = Study(run.path, choosing.ledger(run, url), lease)
        study.refuse_other(common, seed=config.seed, rule=config.search.sampler)
        return run, study
    refuse_taken(name, url)
    budget = {"trials": config.search.trials, "steps": config.search.steps, "episodes": config.search.episodes}
    shared: dict[str, Any] = {} if url is None else {"storage": storage.shown(url)}
    scenario = config.search.scenario.name
    run = provenance.new_run(config, "search", name, parents=parents, scenario=scenario, budget=budget, **shared)
    seed = build.held_out_seed(config.seed, "search")
    bank = scenes.save_bank(run.path / "bank.npz", config.search.scenario, config.search.episodes, seed)
    run.update(bank=scenes.bank_record(bank))
    facts = {"config": config.tree, "run": run.id, "bank": bank.sha256, "trials": config.search.trials}
    rule = config.search.sampler
    study = Study.create(run.path, seed=config.seed, rule=rule, settings=common, url=url, name=name, **facts)
    study.lease = lease
    return run, study


def begun(run: Run, name: str, url: URL | None) -> bool:
    """Whether the run has its study already: a crash may have come between the two."""
    if run.record.get("storage"):
        return url is None or name in known(url)
    return (run.path / "study.db").exists()


def refuse_taken(name: str, url: URL | None) -> None:
    """Reach the shared database before anything is made here, and raise StoreError when it has a study of that name."""
    if url is not None and name in known(url):
        raise StoreError(
            f"{storage.shown(url)} has a study {name} that was begun elsewhere: join it with "
            f"formctl search --worker {name}, or type name=NAME for a new one"
        )


def announce(config: Config, first: Config, run: Run, study: Study) -> None:
    """Say what is there, what is missing and what it will cost."""
    total, missing = config.search.trials, study.missing(config.search.trials)
    say(f"study {run.path}: {total - missing} of {total} done, {missing} to go")
    minutes = budget.training_minutes(first, config.search.steps)
    rounds = -(-missing // config.engine.jobs)
    about = f", about {duration(60 * minutes * rounds)} as earlier trainings here went" if minutes else ""
    side = f", {config.engine.jobs} side by side" if config.engine.jobs > 1 else ""
    spent = f"{missing} x {config.search.steps:,} steps and {config.search.episodes} episodes each{side}"
    say(f"about to spend {spent}{about}: {budget.room(missing * 3 * budget.CHECKPOINT, config.runs)}")


def summary(study: Study) -> dict[str, Any]:
    """Counts and the best trial so far, for the run's record."""
    counts, rows = overview.counts(study.ledger), overview.top(study.ledger, 1)
    if not rows:
        return {**counts, "trial": None, "sr": None, "weights": None}
    row = rows[0]
    rates = {key: row[key] for key in ("sr", "sr_fresh") if row.get(key) is not None}
    return {**counts, "trial": row["trial"], **rates, "weights": [row[f"w_{name}"] for name in OBJECTIVES]}
