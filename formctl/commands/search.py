"""``formctl search``: stage 1, a policy for each of many random weight vectors, and how often each satisfies.

Paper, Sec. IV-B1. ``--trials`` is the total of the study: the same command again finishes what is missing.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from formctl.options import Overrides, ShowConfig, configs

if TYPE_CHECKING:
    import pandas as pd

    from formctl.config import Config
    from formctl.console import Bar
    from formctl.store import Run
    from formctl.study import Study
    from formctl.trial import TrialRequest

SHARED = ("drone", "observation", "reward", "encoder", "algo", "eval", "sim")
"""Groups that all trials of a study have in common, beside the search's own scenario and budgets."""


def command(
    overrides: Overrides = None,
    trials: Annotated[int | None, typer.Option(help="Total number of trials in the study, not more trials.")] = None,
    status: Annotated[bool, typer.Option("--status", help="Show how far the study is and stop.")] = False,
    best: Annotated[bool, typer.Option("--best", help="Show the best trial and stop.")] = False,
    cfg: ShowConfig = False,
) -> None:
    """Stage 1: random reward weights, a policy per weight vector, satisfaction rates in a study store."""
    words = [*(overrides or []), *([] if trials is None else [f"search.trials={trials}"])]
    (config,) = configs(words, show=cfg)
    name = study_name(config, words)
    if status or best:
        from formctl import store

        run = store.resolve(name, config.runs, kind="search")
        asked = config.search.trials if trials is not None else run.record["budget"]["trials"]
        show_best(run) if best else show_status(run, asked)
        return
    show_status(execute(config, name), config.search.trials)


def study_name(config: "Config", overrides: list[str]) -> str:
    """The name the user gave, or the search's own: ``stage1``."""
    given = any(text.startswith("name=") for text in overrides)
    return config.name if given else config.search.name


def execute(config: "Config", name: str, parents: tuple[str, ...] = ()) -> "Run":
    """Bring the study ``name`` to its total and return its run.

    Raises StoreError when the study of that name has other settings; RunFailed when no trial can be finished.
    """
    from formctl import build
    from formctl.config import restore
    from formctl.console import say
    from formctl.trial import settings

    total = config.search.trials
    first = restore(settings(config, name, 0, config.weights))
    build.training(first)  # settings that contradict each other are refused before a folder is made
    run, study = open_study(config, name, parents)
    if study.missing(total):
        finish(config, first, run, study)
    else:
        say(f"study {name}: all {total} trials are there already")
        refuse_barren(run, study)
    return run


def finish(config: "Config", first: "Config", run: "Run", study: "Study") -> None:
    """Run the trials that are missing; ``first`` is the configuration of one of them."""
    from formctl.console import progress
    from formctl.engine import Local
    from formctl.trial import request, run_trial

    total = config.search.trials
    with run.work() as live:
        live.update(budget=live.record["budget"] | {"trials": total})
        announce(config, first, run, study)
        asked = (request(config, run, ticket.trial, ticket.weights) for ticket in study.tickets(total))
        done = total - study.missing(total)
        with progress(f"search {run.path.parent.name}", total, "trials", start=done) as bar:
            watch = Watch(study, bar, done)
            try:
                for finished in Local().run(run_trial, asked, watch.hear):
                    settle(study, finished.request, finished.result, finished.error)
                    live.update(result=summary(study))
                    watch.settled()
            except KeyboardInterrupt as stop:
                raise KeyboardInterrupt(f"{stop or 'interrupted'}; the same command again goes on from there") from stop
        refuse_barren(run, study)


def refuse_barren(run: "Run", study: "Study") -> None:
    """Raise RunFailed when every trial failed: there is nothing to choose from."""
    from formctl.errors import RunFailed

    if not study.counts()["done"]:
        raise RunFailed(f"all {study.counts()['failed']} trials failed; their reasons: {run.path / 'trials.parquet'}")


def open_study(config: "Config", name: str, parents: tuple[str, ...]) -> "tuple[Run, Study]":
    """The study ``name``, continued or made, with its fixed evaluation bank."""
    from formctl import evaluation, provenance, store
    from formctl.build import held_out_seed
    from formctl.study import Study

    settings = {group: config.tree[group] for group in SHARED}
    settings["search"] = {key: config.tree["search"][key] for key in ("scenario", "steps", "episodes")}
    run = store.latest(config.runs, "search", name)
    if run is not None and (run.path / "study.db").exists():
        study = Study.open(run.path)
        study.refuse_other(settings, seed=config.seed, rule=config.search.sampler)
        return run, study
    budget = {"trials": config.search.trials, "steps": config.search.steps, "episodes": config.search.episodes}
    scenario = config.search.scenario.name
    run = provenance.new_run(config, "search", name, parents=parents, scenario=scenario, budget=budget)
    seed = held_out_seed(config.seed, "search")
    bank = evaluation.save_bank(run.path / "bank.npz", config.search.scenario, config.search.episodes, seed)
    run.update(bank=evaluation.facts(bank))
    return run, Study.create(run.path, seed=config.seed, rule=config.search.sampler, settings=settings)


def announce(config: "Config", first: "Config", run: "Run", study: "Study") -> None:
    """Say what is there, what is missing and what it will cost."""
    from formctl import build, spending
    from formctl.console import say

    total, missing = config.search.trials, study.missing(config.search.trials)
    say(f"study {run.path}: {total - missing} of {total} done, {missing} to go")
    build.use_threads(config)
    calibration = spending.calibrate(build.training(first))
    seconds = spending.training_seconds(calibration, config.search.steps)
    seconds = missing * (seconds + spending.flying_seconds(first, config.search.episodes))
    cost = spending.sentence(seconds, missing * 3 * calibration.bytes, config.runs, compiled=config.train.compile)
    say(f"about to spend {missing} x {config.search.steps:,} steps and {config.search.episodes} episodes each: {cost}")


class Watch:
    """What the engine tells while trials run: the progress line, and ten points of each learning curve."""

    def __init__(self, study: "Study", bar: "Bar", done: int) -> None:
        self.study, self.bar, self.done = study, bar, done
        self.tenths: dict[int, int] = {}

    def hear(self, asked: "TrialRequest", note: Mapping[str, Any]) -> None:
        """A trial is further on: training CFR, with exploration noise, is the learning curve."""
        steps, total = note["steps"], note["total"]
        self.bar.update(self.done + steps / total, f"trial {asked.trial}: {steps:,} of {total:,} steps")
        tenth = 10 * steps // total
        if tenth > self.tenths.get(asked.trial, 0) and note["cfr"] is not None:
            self.tenths[asked.trial] = tenth
            self.study.report(asked.trial, steps, note["cfr"])

    def settled(self) -> None:
        self.done += 1
        self.bar.update(self.done)


def settle(study: "Study", asked: "TrialRequest", outcome: Mapping[str, Any] | None, error: Exception | None) -> None:
    """Record how a trial ended. A store that cannot be written is no failure of the trial: it is raised again."""
    from formctl.console import say, warn
    from formctl.files import StoreError

    if isinstance(error, StoreError):
        raise error
    if error is not None or outcome is None:
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        warn(f"trial {asked.trial} failed: {reason}")
        study.fail(asked.trial, reason, seed=asked.settings["seed"])
        return
    study.finish(asked.trial, outcome)
    w = asked.settings["weights"]
    vector = ", ".join(f"{key} {w[key]:.2f}" for key in ("formation", "flight", "obstacle", "action"))
    say(f"trial {asked.trial}: SR {outcome['sr']:.3f} ({outcome['sr_k']} of {outcome['sr_n']}) with {vector}")


def summary(study: "Study") -> dict[str, Any]:
    """Counts and the best trial so far, for the run's record."""
    from formctl.trials import best, row_weights

    counts = study.counts()
    if not counts["done"]:
        return {**counts, "trial": None, "sr": None, "weights": None}
    row = best(study.table())
    return {**counts, "trial": int(row["trial"]), "sr": float(row["sr"]), "weights": list(row_weights(row))}


def show_status(run: "Run", total: int) -> None:
    """How far the study is, trial by trial."""
    from formctl import console
    from formctl.trials import read_table

    trials = read_table(run.path)
    done, failed = (int((trials["state"] == state).sum()) for state in ("done", "failed"))
    failures = f" ({failed} failed)" if failed else ""
    to_go = max(0, total - done - failed)
    console.say(f"study {run.path}: {done + failed} of {total} done{failures}, {to_go} to go")
    columns = ("trial", "state", "formation", "flight", "obstacle", "action", "SR", "CFR", "FM", "minutes")
    console.table(columns, [trial_cells(row) for _, row in trials.iterrows()])
    if done:
        show_best(run)


def trial_cells(row: "pd.Series") -> list[str]:
    """A trial as a line of the status table."""
    from formctl.trials import row_weights

    rate = "" if _missing(row["sr"]) else f"{row['sr']:.3f} ({row['sr_k']} of {row['sr_n']})"
    figures = ["" if _missing(row[key]) else f"{row[key]:.3f}" for key in ("cfr", "fm", "minutes")]
    return [str(row["trial"]), row["state"], *(f"{weight:.3f}" for weight in row_weights(row)), rate, *figures]


def show_best(run: "Run") -> None:
    """The best trial and how to take it on."""
    from formctl.console import say
    from formctl.trials import best, read_table, row_weights

    row = best(read_table(run.path))
    names = ("formation", "flight", "obstacle", "action")
    vector = ", ".join(f"{name} {weight:.4f}" for name, weight in zip(names, row_weights(row), strict=True))
    say(f"best: trial {row['trial']}, SR {row['sr']:.3f} ({row['sr_k']} of {row['sr_n']}), weights {vector}")
    say(f"take it on: formctl train weights=@{run.path.parent.name}/best")


def _missing(value: object) -> bool:
    import pandas as pd

    return bool(pd.isna(value))  # type: ignore[call-overload]
