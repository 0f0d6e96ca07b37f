"""``formctl search``: stage 1, a policy for each of many random weight vectors, and how often each satisfies.

Paper, Sec. V-B1. ``--trials`` is the total of the study: the same command again finishes what is missing.
"""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from formctl.commands.options import Overrides, ShowConfig, configs

if TYPE_CHECKING:
    from formctl.settings import Config
    from formctl.store import Run


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
    alike: Annotated[
        bool, typer.Option("--alike", help="Draw one episode as trials of like SR fly it, and stop.")
    ] = False,
    dashboard: Annotated[
        bool, typer.Option("--dashboard", help="Show the study in optuna-dashboard, read-only, until Ctrl-C.")
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
        from formctl.search.joining import join

        join(worker, words, storage)
    elif status or top or sensitivity or alike or dashboard or best:
        asked = {"top": top, "sensitivity": sensitivity, "alike": alike, "dashboard": dashboard, "best": best}
        show(words, storage, asked, trials)
    else:
        begin(words, storage, cfg, retry_failed)


def begin(words: list[str], address: str | None, cfg: bool, retry: bool) -> None:
    """Bring the study of a call to its total and say how it stands."""
    (config,) = configs(words, show=cfg)
    from formctl.search import beginning, choosing, storage

    name = study_name(config, words)
    run, study = beginning.execute(config, name, url=storage.given(address), retry=retry)
    choosing.show_status(name, run, study.ledger, config.search.trials)


def show(words: list[str], address: str | None, asked: dict[str, Any], trials: int | None) -> None:
    """Answer a question about a study that is there."""
    from formctl.search import choosing

    name, run, ledger = choosing.find(words, address)
    if asked["top"]:
        choosing.show_top(ledger, asked["top"])
    elif asked["dashboard"]:
        from formctl.search.dashboard import serve

        serve(ledger)
    elif asked["sensitivity"]:
        from formctl.search.sensitivity import show as show_sensitivity

        show_sensitivity(here(name, run), ledger)
    elif asked["alike"]:
        from formctl.search.alike import show as show_alike

        show_alike(here(name, run), ledger)
    elif asked["best"]:
        show_winner(name, here(name, run), ledger)
    else:
        choosing.show_status(name, run, ledger, trials)


def here(name: str, run: "Run | None") -> "Run":
    """The study's run folder. Raises StoreError where it is on other hosts only."""
    from formctl.store.files import StoreError

    if run is None:
        raise StoreError(f"the policies of {name} are not on this host; --status and --top work everywhere")
    return run


def show_winner(name: str, run: "Run", ledger: "Any") -> None:
    """The best trial, flown on the fresh bank unless that is known. Raises StoreError when none is done."""
    from formctl.search import choosing, overview
    from formctl.search.study import Study
    from formctl.store.files import StoreError

    rows = overview.top(ledger, 1)
    if not rows:
        raise StoreError("no trial of the study is done yet; `formctl search --status` shows how far it is")
    if rows[0].get("sr_fresh") is None:
        from formctl.search.trial import settings
        from formctl.settings import restore

        config = restore(run.config)
        choosing.confirm(Study(run.path, ledger), restore(settings(config, name, 0, config.weights)))
        rows = overview.top(ledger, 1)
    choosing.show_best(name, rows[0])


def study_name(config: "Config", overrides: list[str]) -> str:
    """The name the user gave, or the search's own: ``stage1``."""
    given = any(text.startswith("name=") for text in overrides)
    return config.name if given else config.search.name
