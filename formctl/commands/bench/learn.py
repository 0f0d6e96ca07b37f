"""``formctl bench learn``: minutes and steps until a learner reaches the marks, from trainings run here or before."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from formctl.commands.bench.train import compose_learner
from formctl.commands.options import Overrides

if TYPE_CHECKING:
    import pandas as pd

    from formctl.store import Run
    from formctl.timing.marks import Learnt, Mark

DEFAULT = ("shac", "mappo_fast")


def learn(
    overrides: Overrides = None,
    learner: Annotated[
        list[str] | None,
        typer.Option("--learner", help="A file of conf/algo; may be repeated. Default shac and mappo_fast."),
    ] = None,
    seed: Annotated[list[int] | None, typer.Option(min=0, help="May be repeated. Default 0.")] = None,
    run: Annotated[
        list[str] | None,
        typer.Option("--run", help="Read a training (path, id or name of its run) instead; may be repeated."),
    ] = None,
    cfr: Annotated[float, typer.Option(min=0, max=1, help="CFR of the mark.")] = 0.89,
    fm: Annotated[float, typer.Option(min=0, help="FM of the mark, m.")] = 0.278,
) -> None:
    """Minutes and steps until CFR and FM reach a mark in one judgement, per learner and seed."""
    from formctl import console, store
    from formctl.settings import compose
    from formctl.store import provenance
    from formctl.timing.marks import Mark

    settings = compose(overrides or [])
    mark = Mark(cfr, fm)
    if run:
        runs = [store.resolve(text, settings.runs, kind="train") for text in run]
    else:
        runs = trained(overrides, learner or list(DEFAULT), seed or [0])
    bench = provenance.new_run(settings, "bench", parents=tuple(dict.fromkeys(one.id for one in runs)))
    with bench.work() as live:
        results = [result(one, mark) for one in runs]
        live.update(result={"mark": asdict(mark), "trainings": [asdict(one) for one in results]})
        write(live, runs, results, mark)
    title = f"first judgement with CFR >= {cfr:g} and FM <= {fm:g} m"
    columns = ("learner", "seed", "steps", "minutes", "flown to", "best CFR", "FM there", "run")
    console.table(columns, [cells(one) for one in results], title=title)
    for name in ("marks.csv", "curves.csv", "curves.png"):
        console.say(f"written: {bench.path / name}")


def trained(overrides: list[str] | None, learners: list[str], seeds: list[int]) -> "list[Run]":
    """Train every learner with every seed, one after another; all settings are checked before the first begins."""
    from formctl.stages.train import execute

    configs = [
        compose_learner([*(overrides or []), f"seed={seed}", f"name=learn_{name}"], name)
        for name in learners
        for seed in seeds
    ]
    return [execute(config) for config in configs]


def result(run: "Run", mark: "Mark") -> "Learnt":
    """What a training's run says about the mark."""
    from formctl.timing.marks import learnt

    return learnt(label(run), int(run.record["seed"]), run.id, run.metrics(), mark)


def label(run: "Run") -> str:
    """The learner of a training, and what else it was: its experiment, a curriculum with periods, another encoder."""
    method: dict[str, Any] = run.record.get("method") or {}
    usual = {"algo": "", "experiment": "", "curriculum": "none", "encoder": "attention"}
    return " ".join(str(method[key]) for key, value in usual.items() if method.get(key) not in (None, "", value))


def write(live: "Run", runs: "list[Run]", results: "list[Learnt]", mark: "Mark") -> None:
    """``marks.csv``, ``curves.csv`` (every judgement) and ``curves.png`` in the run's folder."""
    import pandas as pd

    from analysis.figures import marks as figure
    from analysis.figures import style
    from formctl.store.files import atomic, write_text

    table = pd.concat([curve(run, one) for run, one in zip(runs, results, strict=True)], ignore_index=True)
    write_text(live.path / "marks.csv", pd.DataFrame([asdict(one) for one in results]).to_csv(index=False))
    write_text(live.path / "curves.csv", table.to_csv(index=False))
    with atomic(live.path / "curves.png") as path, style.styled():
        figure.draw_marks(table, mark.cfr, mark.fm).savefig(path, format="png")


def curve(run: "Run", one: "Learnt") -> "pd.DataFrame":
    """The judgements of a training, one row each."""
    import pandas as pd

    from formctl.timing.marks import JUDGED

    rows = [row for row in run.metrics() if all(key in row for key in JUDGED)]
    plain = {
        "learner": [one.learner] * len(rows),
        "seed": [one.seed] * len(rows),
        "run": [run.id] * len(rows),
        **{key: [row[key] for row in rows] for key in ("steps", "minutes")},
        **{key.removeprefix("judge/"): [row[key] for row in rows] for key in JUDGED},
    }
    return pd.DataFrame(plain)


def cells(one: "Learnt") -> tuple[str, ...]:
    """A training as a line of the table."""
    steps = "not reached" if one.steps is None else f"{one.steps:,}"
    minutes = "" if one.minutes is None else f"{one.minutes:.1f}"
    flown = f"{one.last_steps:,} in {one.last_minutes:.1f} min"
    best, there = ("" if value is None else f"{value:.3f}" for value in (one.best_cfr, one.fm_at_best))
    return one.learner, str(one.seed), steps, minutes, flown, best, there, one.run
