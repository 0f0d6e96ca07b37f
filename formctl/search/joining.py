"""Working for a study that another host began: ``formctl search --worker STUDY --storage postgresql://...``.

The study's settings come from its database. Hosts that share the runs folder go on from each other's checkpoints; on
others the folder is made anew, with the same evaluation bank, and a trial that its host lost begins again.
"""

from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from formctl import store
from formctl.console import say
from formctl.errors import ConfigError
from formctl.search import choosing, sitting, storage
from formctl.search.ledger import Ledger
from formctl.search.study import Study
from formctl.settings import Config, compose, restore
from formctl.store import provenance
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sqlalchemy import URL

OWN = ("runs", "engine", "logger", "profile")
"""Settings that a worker chooses for itself; ``profile`` only changes budgets, which are the study's."""


def join(name: str, words: Sequence[str], address: str | None) -> None:
    """Work for the study until it is whole, and say how it stands. Raises StoreError, ConfigError."""
    url = storage.given(address)
    if url is None:
        raise StoreError(
            f"--worker {name} needs the shared storage: --storage postgresql://... or {storage.VARIABLE}; "
            "on one host engine.jobs=N does the same"
        )
    for word in words:
        if word.split("=")[0].split(".")[0] not in OWN:
            raise ConfigError(f"{word} cannot be set by a worker: the study's settings are those it was begun with")
    ledger = Ledger(url, name)
    config = settings(ledger, words)
    run = folder(config, name, ledger, url)
    study = Study(run.path, ledger, 60 * config.search.lease_minutes)
    total = ledger.total()
    say(f"working for study {name} in {storage.shown(url)}: {study.missing(total)} of {total} to go")
    with owned(run):
        sitting.work(study, run, config, total, lambda: None)
        while study.missing(total := ledger.total()):  # its owner has asked for more in the meantime
            sitting.work(study, run, config, total, lambda: None)
    choosing.show_status(name, run, ledger, total)


def settings(ledger: Ledger, words: Sequence[str]) -> Config:
    """The study's settings with this worker's own. Raises StoreError where this program would measure otherwise."""
    from envs.vocabulary import METRIC_VERSION

    theirs = ledger.facts["settings"].get("metric_version")
    if theirs != METRIC_VERSION:
        raise StoreError(
            f"study {ledger.name} counts by metric version {theirs}, this formctl by {METRIC_VERSION}: "
            "work for it with the version that began it"
        )
    own = compose(list(words)).tree
    return restore(ledger.facts["config"] | {key: own[key] for key in ("runs", "engine", "logger")})


def folder(config: Config, name: str, ledger: Ledger, url: "URL") -> store.Run:
    """The study's run folder here: the shared one, or one of this host's own with the same bank."""
    from formctl.evaluation import scenes
    from formctl.settings import build

    path = Path(config.runs) / "search" / name / str(ledger.facts["run"])
    if (path / "run.json").exists():
        return store.Run.open(path)
    budget = {"trials": ledger.facts["trials"], "steps": config.search.steps, "episodes": config.search.episodes}
    seed = build.held_out_seed(config.seed, "search")
    bank = scenes.save_bank(path / "bank.npz", config.search.scenario, config.search.episodes, seed)
    if bank.sha256 != ledger.facts["bank"]:
        raise StoreError(
            f"the episodes drawn here are not those of study {name}: another version of formctl or numpy began it"
        )
    return provenance.new_run(
        config,
        "search",
        name,
        folder=path,
        identifier=path.name,
        scenario=config.search.scenario.name,
        budget=budget,
        bank=scenes.bank_record(bank),
        storage=storage.shown(url),
    )


@contextmanager
def owned(run: store.Run) -> "Iterator[None]":
    """Keep the record of this host's own folder; a folder that another process keeps is only written into."""
    if run.in_use():
        yield
        return
    with run.work():
        yield
