"""Minutes and steps until finished trainings reached a mark: the first judgement with CFR and FM good enough.

python -m tests.benchmarks.marks main --cfr 0.89 --fm 0.278 --out marks
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from analysis.figures import style
from formctl import store
from formctl.console import table
from formctl.store import Run
from tests.benchmarks import marks_figure as figure

JUDGED = ("judge/cfr", "judge/fm")


@dataclass(frozen=True)
class Mark:
    """What a training has to reach in one judgement: CFR at least, FM in m at most."""

    cfr: float
    fm: float

    def reached(self, row: Mapping[str, Any]) -> bool:
        """Whether a line of metrics.jsonl is a judgement that reaches the mark."""
        return all(key in row for key in JUDGED) and row["judge/cfr"] >= self.cfr and row["judge/fm"] <= self.fm


@dataclass(frozen=True)
class Learnt:
    """How one training went. Minutes include compiling and judging; steps and minutes are None short of the mark."""

    learner: str
    seed: int
    run: str
    steps: int | None
    minutes: float | None
    last_steps: int  # of the last judgement
    last_minutes: float
    best_cfr: float | None
    fm_at_best: float | None  # m, of the judgement with the best CFR


def learnt(learner: str, seed: int, run: str, rows: Sequence[Mapping[str, Any]], mark: Mark) -> Learnt:
    """What a training's metrics say about the mark."""
    judged = [row for row in rows if all(key in row for key in JUDGED)]
    first = next((row for row in judged if mark.reached(row)), None)
    best = max(judged, key=lambda row: (row["judge/cfr"], -row["judge/fm"]), default=None)
    end = judged[-1] if judged else {"steps": 0, "minutes": 0.0}
    return Learnt(
        learner,
        seed,
        run,
        None if first is None else int(first["steps"]),
        None if first is None else float(first["minutes"]),
        int(end["steps"]),
        float(end["minutes"]),
        None if best is None else float(best["judge/cfr"]),
        None if best is None else float(best["judge/fm"]),
    )


def label(run: Run) -> str:
    """The learner of a training, and what else it was: its experiment, a curriculum with periods, another encoder."""
    method: dict[str, Any] = run.record.get("method") or {}
    usual = {"algo": "", "experiment": "", "curriculum": "none", "encoder": "attention"}
    return " ".join(str(method[key]) for key, value in usual.items() if method.get(key) not in (None, "", value))


def curve(run: Run, learner: str) -> pd.DataFrame:
    """The judgements of a training, one row each."""
    rows = pd.DataFrame([row for row in run.metrics() if all(key in row for key in JUDGED)])
    judged = rows[["steps", "minutes", *JUDGED]].rename(columns=lambda name: name.removeprefix("judge/"))
    return judged.assign(learner=learner, seed=int(run.record["seed"]), run=run.id)


def main(
    runs: Annotated[list[str], typer.Argument(help="Trainings: path, id or name.")],
    at: Annotated[Path, typer.Option("--store", help="The store.")] = Path("runs"),
    cfr: Annotated[float, typer.Option(min=0, max=1, help="CFR of the mark.")] = 0.89,
    fm: Annotated[float, typer.Option(min=0, help="FM of the mark, m.")] = 0.278,
    out: Annotated[Path | None, typer.Option(help="Folder for marks.csv, curves.csv and curves.png.")] = None,
) -> None:
    """Print one line per training."""
    chosen = [store.resolve(text, at, kind="train") for text in runs]
    results = [learnt(label(run), int(run.record["seed"]), run.id, run.metrics(), Mark(cfr, fm)) for run in chosen]
    lines = [[str(value) for value in asdict(one).values()] for one in results]
    table(list(asdict(results[0])), lines, title=f"first judgement with CFR >= {cfr:g} and FM <= {fm:g} m")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        curves = pd.concat([curve(run, one.learner) for run, one in zip(chosen, results, strict=True)])
        pd.DataFrame([asdict(one) for one in results]).to_csv(out / "marks.csv", index=False)
        curves.to_csv(out / "curves.csv", index=False)
        with style.styled():
            figure.draw_marks(curves, cfr, fm).savefig(out / "curves.png")


if __name__ == "__main__":
    typer.run(main)
