"""``formctl search``: stage 1, a policy for each of many random weight vectors, and how often each satisfies.

Paper, Sec. V-B1. ``--trials`` is the total of the study: the same command again finishes what is missing.
"""

from typing import Annotated

import typer

from formctl.commands.options import Overrides, ShowConfig, show_settings


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
    if status or top:
        from formctl.search import results

        view = results.StudyView.find(words, storage)
        results.show_top(view.rows(), top) if top else results.show_status(view, trials)
    elif sensitivity or alike or dashboard:
        from formctl.stages.search import show_study

        show_study(words, storage, "sensitivity" if sensitivity else "alike" if alike else "dashboard")
    elif cfg:
        show_settings(words)
    else:
        from formctl.stages import search

        if worker is not None:
            search.join(worker, words, storage)
        elif best:
            search.show_winner(words, storage)
        else:
            search.search(words, storage=storage, retry_failed=retry_failed)
