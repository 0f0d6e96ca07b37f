"""Stage 1, a study of reward weights (paper, Sec. V-B): what ``formctl search`` does.

Begun or continued on the host that owns it, or worked for from another host through a shared database; brought to its
total, its winner confirmed.
"""

import socket
from collections.abc import Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from statistics import median
from typing import Any

from sqlalchemy import URL

from envs.vocabulary import METRIC_VERSION
from formctl import budget, store
from formctl.console import duration, say
from formctl.errors import ConfigError, RunFailed
from formctl.evaluation import scenes
from formctl.search import confirm, dashboard, database, diversity, results, sensitivity, table, trial, worker
from formctl.search.leases import Ticket
from formctl.search.results import StudyView
from formctl.search.study import FACTS, WeightStudy, known
from formctl.search.trial import TrialRequest
from formctl.settings import Config, build, compose, restore
from formctl.stages import train
from formctl.store import Run, provenance
from formctl.store.files import StoreError

SHARED = ("drone", "observation", "reward", "encoder", "algo", "eval", "sim")
"""Groups that all trials of a study have in common, beside the search's own scenario and budgets."""

OWN = ("runs", "engine", "logger", "profile")
"""Settings that a worker chooses for itself; ``profile`` only changes budgets, which are the study's."""


def search(overrides: Sequence[str] = (), *, storage: str | None = None, retry_failed: bool = False) -> Run:
    """Bring the study of a call to its total, say how it stands, and return its run.

    Raises StoreError when the study of that name has other settings; RunFailed when no trial can be finished.
    """
    config = compose(overrides)
    named = any(word.startswith("name=") for word in overrides)
    name = config.name if named else config.search.name
    run = execute(config, name, url=database.given(storage), retry_failed=retry_failed)
    results.show_status(view_of(run, database.given(storage)), config.search.trials)
    return run


def execute(
    config: Config, name: str, *, url: URL | None = None, parents: Sequence[str] = (), retry_failed: bool = False
) -> Run:
    """Bring the study ``name`` to its total and confirm its winner; returns its run."""
    first = restore(trial.settings(config, name, 0, config.weights))
    build.training(first)  # settings that contradict each other are refused before a folder is made
    run, study = open_study(config, name, parents, url)
    missing = study.missing(config.search.trials)
    with run.work() as live, database.written_ahead(study.url), closing(study):
        live.update(budget=live.record["budget"] | {"trials": config.search.trials})
        if missing or (retry_failed and study.counts()["failed"]):
            finish(config, first, live, study, retry_failed)
        else:
            say(f"study {name}: all {config.search.trials} trials are there already")
        refuse_barren(live, study)
        confirm.fly_winner(study, live, config)
        confirm.retrain_best(study, live, config)
        live.update(result=results.summary(study.rows()))
    return run


def finish(config: Config, first: Config, run: Run, study: WeightStudy, retry_failed: bool) -> None:
    """Run the trials that are missing; ``first`` is the configuration of one of them."""
    total = config.search.trials
    if study.url.drivername == "sqlite":  # its one owner is here: whoever had a lease is gone
        study.leases.end_all()
    study.note(trials=total)
    if retry_failed:
        say(f"failed trials to try once more: {study.leases.reopen(total)}")
    announce(config, first, run, study)
    run_trials(config, run, study, total)


def run_trials(config: Config, run: Run, study: WeightStudy, total: int) -> None:
    """Work for the study until it has ``total`` trials."""

    def ask(ticket: Ticket) -> TrialRequest:
        return trial.request(config, run, ticket.trial, ticket.weights)

    worker.work(
        study,
        config,
        total,
        ask,
        label=f"search {run.path.parent.name}",
        on_recorded=lambda: run.update(result=results.summary(study.rows())),
    )


def refuse_barren(run: Run, study: WeightStudy) -> None:
    """Raise RunFailed when every trial failed: there is nothing to choose from."""
    if not study.counts()["done"]:
        raise RunFailed(f"all {study.counts()['failed']} trials failed; their reasons: {run.path / 'trials.parquet'}")


def open_study(config: Config, name: str, parents: Sequence[str], url: URL | None) -> tuple[Run, WeightStudy]:
    """The study ``name``, continued or made, with its fixed evaluation bank."""
    common = {group: config.tree[group] for group in SHARED}
    common["search"] = {key: config.tree["search"][key] for key in ("scenario", "steps", "episodes")}
    common["metric_version"] = METRIC_VERSION
    run = store.latest(config.runs, "search", name)
    if run is not None and begun(run, name, url):
        study = WeightStudy(run.path, results.address_of(run, url), name if url else table.NAME)
        study.refuse_other(common, seed=config.seed, rule=config.search.sampler)
    else:
        run, study = make_study(config, name, parents, url, common)
    study.lease = 60 * config.search.lease_minutes
    return run, study


def make_study(
    config: Config, name: str, parents: Sequence[str], url: URL | None, common: dict[str, Any]
) -> tuple[Run, WeightStudy]:
    """A new study in a new run. Raises StoreError, before anything is made, where a shared database has that name."""
    shared: dict[str, Any] = {}
    if url is not None:
        shared["storage"] = database.shown(url)
        if name in known(url):
            raise StoreError(
                f"{database.shown(url)} has a study {name} that was begun elsewhere: join it with "
                f"formctl search --worker {name}, or type name=NAME for a new one"
            )
    run = new_run(config, name, config.search.trials, parents=tuple(parents), **shared)
    facts = {"config": config.tree, "run": run.id, "bank": run.record["bank"]["sha256"], "trials": config.search.trials}
    rule, study = config.search.sampler, name if url else table.NAME
    return run, WeightStudy.create(run.path, seed=config.seed, rule=rule, settings=common, url=url, name=study, **facts)


def new_run(config: Config, name: str, trials: int, **fields: Any) -> Run:
    """A search's run with the episodes that all trials are judged on."""
    budgets = {"trials": trials, "steps": config.search.steps, "episodes": config.search.episodes}
    scenario = config.search.scenario
    run = provenance.new_run(config, "search", name, scenario=scenario.name, budget=budgets, **fields)
    seed = build.held_out_seed(config.seed, "search")
    bank = scenes.save_bank(run.path / "bank.npz", scenario, config.search.episodes, seed)
    run.update(bank=scenes.bank_record(bank))
    return run


def begun(run: Run, name: str, url: URL | None) -> bool:
    """Whether the run has its whole study already: a crash may have come between the two."""
    if run.record.get("storage"):
        return url is None or name in known(url)
    path = run.path / "study.db"
    return path.exists() and set(FACTS) <= WeightStudy.recorded_facts(database.sqlite(path), table.NAME).keys()


def announce(config: Config, first: Config, run: Run, study: WeightStudy) -> None:
    """Say what the trials are made of, what is there, what is missing, and what that needs."""
    total, missing = config.search.trials, study.missing(config.search.trials)
    say(f"study {run.path}: {total - missing} of {total} done, {missing} to go")
    law = f"{study.rule}, study seed {study.seed}, one vector per trial"
    lines = [f"weights: {law}" if line.startswith("weights:") else line for line in train.described(first)]
    for line in [line for line in lines if not line.startswith("curriculum")]:
        say(line)
    jobs = max(1, min(config.engine.workers, missing))
    side = f", {jobs} side by side" if jobs > 1 else ""
    say(
        f"about to run {missing} x {config.search.steps:,} steps of {config.search.scenario.name} and"
        f" {config.search.episodes} episodes each{side}"
    )
    again = config.search.confirm
    if again.trials:
        steps = again.budget * config.search.steps
        say(f"then the best {min(again.trials, total)} again, with {again.seeds} seeds of {steps:,} steps each")
    here = [row["minutes"] for row in study.rows() if row["state"] == "done" and row["host"] == socket.gethostname()]
    minutes = median(here) if here else budget.training_minutes(first, config.search.steps)
    each = f"about {duration(60 * minutes)} each" if minutes else ""
    whole = f", {duration(60 * minutes * -(-missing // jobs))} in all, as earlier ones here went; " if minutes else ""
    say(f"{each}{whole}{budget.room(missing * 3 * budget.CHECKPOINT, config.runs)}")


def join(name: str, overrides: Sequence[str] = (), storage: str | None = None) -> Run:
    """Work for a study that another host began until it is whole; returns the run of this host's folder.

    The study's settings come from its database. Hosts that share the runs folder go on from each other's checkpoints;
    on others the folder is made anew, with the same evaluation bank, and a trial that its host lost begins again.
    Raises StoreError, ConfigError.
    """
    url = database.given(storage)
    if url is None:
        raise StoreError(
            f"--worker {name} needs the shared storage: --storage postgresql://... or {database.VARIABLE}; "
            "on one host engine.jobs=N does the same"
        )
    for word in overrides:
        if word.split("=")[0].split(".")[0] not in OWN:
            raise ConfigError(f"{word} cannot be set by a worker: the study's settings are those it was begun with")
    study = WeightStudy(Path(), url, name)
    config = worker_settings(study, overrides)
    run = worker_folder(config, study)
    study.folder, study.lease = run.path, 60 * config.search.lease_minutes
    say(f"working for study {name} in {database.shown(url)}: {study.missing(study.total())} of {study.total()} to go")
    with nullcontext() if run.in_use() else run.work():  # another process here may keep the record
        while study.missing(total := study.total()):  # its owner may ask for more in the meantime
            run_trials(config, run, study, total)
        confirm.retrain_best(study, run, config)
    results.show_status(view_of(run, url), total)
    return run


def worker_settings(study: WeightStudy, overrides: Sequence[str]) -> Config:
    """The study's settings with this worker's own. Raises StoreError where this program would measure otherwise."""
    theirs = study.settings.get("metric_version")
    if theirs != METRIC_VERSION:
        raise StoreError(
            f"study {study.name} counts by metric version {theirs}, this formctl by {METRIC_VERSION}: "
            "work for it with the version that began it"
        )
    own = compose(list(overrides)).tree
    return restore(study.facts["config"] | {key: own[key] for key in ("runs", "engine", "logger")})


def worker_folder(config: Config, study: WeightStudy) -> Run:
    """The study's run folder here: the shared one, or one of this host's own with the same bank."""
    path = Path(config.runs) / "search" / study.name / str(study.facts["run"])
    if (path / "run.json").exists():
        return Run.open(path)
    where = {"folder": path, "identifier": path.name, "storage": database.shown(study.url)}
    run = new_run(config, study.name, study.facts["trials"], **where)
    if run.record["bank"]["sha256"] != study.facts["bank"]:
        raise StoreError(
            f"the episodes drawn here are not those of study {study.name}: another version of formctl or numpy began it"
        )
    return run


def show_winner(overrides: Sequence[str], storage: str | None = None) -> None:
    """The winner, flown on the fresh bank unless that is known. Raises StoreError when no trial is done."""
    view = StudyView.find(overrides, storage)
    config = restore(Run(view.folder).config)
    confirm.fly_winner(WeightStudy(view.folder, view.url, view.study), Run(view.folder), config)
    results.show_best(view.name, view.rows())


def show_study(overrides: Sequence[str], storage: str | None, what: str) -> None:
    """One of the other views of a study: ``sensitivity``, ``alike`` or ``dashboard``."""
    view = StudyView.find(overrides, storage)
    if what == "dashboard":
        dashboard.serve(view.name, view.url)
    elif what == "sensitivity":
        sensitivity.show(view)
    else:
        diversity.show(view)


def view_of(run: Run, url: URL | None) -> StudyView:
    """A study whose run is here."""
    return StudyView(run.path.parent.name, results.address_of(run, url), run)
