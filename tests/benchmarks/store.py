"""What the search's store costs: milliseconds per trial event, and seconds until a large study has said how it stands.

python -m tests.benchmarks.store --trials 300 --large 10000
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import sqlalchemy
import typer

from envs.vocabulary import OBJECTIVES
from formctl.console import table as print_table
from formctl.console import track
from formctl.search import laws, table
from formctl.search.leases import TRIALS
from formctl.search.study import WeightStudy
from formctl.settings import compose
from formctl.store import provenance

ROOT = Path(__file__).resolve().parents[2]


def outcome(trial: int) -> dict[str, Any]:
    """What a finished trial keeps, made up."""
    rate = (37 * trial % 1000) / 1000
    figures = {"sr": rate, "sr_k": int(200 * rate), "sr_n": 200, "cfr": rate, "fm": 0.3, "throttle_change": 0.01}
    figures |= {f"ok_{name}": rate for name in OBJECTIVES} | {"episodes": f"{(1 << int(200 * rate)) - 1:050x}"}
    place = {"seed": 0, "budget": 1_000_000, "steps": 1_000_000, "minutes": 3.0, "host": "bench"}
    return figures | place | {"run": f"trials/{trial:04d}", "policy": f"trials/{trial:04d}/policy.pt"}


def measure(study: WeightStudy, trials: int, events: int) -> Iterator[tuple[str, list[float]]]:
    """Each kind of event and how long it took (ms), on a study that has ``trials`` trials already."""
    tickets: list[Any] = []
    yield "claim: hand a trial out", timed(events, lambda _: tickets.append(study.claim(trials + events)))
    yield "report: a point of the learning curve", timed(events, lambda k: study.report(tickets[k], 1000, 0.5))
    yield "finish: the outcome", timed(events, lambda k: study.finish(tickets[k], outcome(k)))
    yield "the table of all trials, rewritten", timed(1, lambda _: study.write_table())


def enlarge(study: WeightStudy, trials: int) -> None:
    """Make the study say that it has so many finished trials. Those that are added are in the leases and in the table,
    which is all that --status asks, and not in Optuna, which takes a tenth of a second for each."""
    rows = study.rows()
    added = [dict.fromkeys(table.COLUMNS) | outcome(k) for k in range(len(rows), trials)]
    vectors = [laws.weights(0, k, "dirichlet") for k in range(len(rows), trials)]
    own = [{"trial": k, "number": k, "state": "done"} for k in range(len(rows), trials)]
    named = [dict(zip(laws.PARAMETERS, vector, strict=True)) for vector in vectors]
    table.write(study.folder, [*rows, *(a | b | c for a, b, c in zip(added, own, named, strict=True))])
    begun = {"study": study.name, "seen": time.time(), "losses": 0}
    with sqlalchemy.create_engine(study.url).begin() as connection:
        values = [begun | row | {"weights": vector} for row, vector in zip(own, vectors, strict=True)]
        connection.execute(TRIALS.insert(), values)


def timed(times: int, act: Callable[[int], object]) -> list[float]:
    """Milliseconds of each."""
    took = []
    for number in range(times):
        begun = time.perf_counter()
        act(number)
        took.append(1000 * (time.perf_counter() - begun))
    return took


def status(folder: Path) -> None:
    """The command as a process of its own, from start to end."""
    words = [f"name={folder.parent.name}", f"runs={folder.parents[2]}"]
    call = [sys.executable, "-m", "formctl", "search", "--status", *words]
    subprocess.run(call, check=True, capture_output=True, env=os.environ | {"PYTHONPATH": str(ROOT)})


def main(
    trials: Annotated[int, typer.Option(min=1, help="Trials that the study has when events are timed.")] = 300,
    events: Annotated[int, typer.Option(min=1, help="Events of each kind that are timed.")] = 50,
    large: Annotated[
        int, typer.Option(min=1, help="Trials that the study has when it is asked how it stands.")
    ] = 10_000,
) -> None:
    """Fill a study on SQLite in a temporary folder and time it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "search" / "store" / "study"
        budget = {"trials": trials}
        run = provenance.new_run(compose([f"runs={name}"]), "search", "store", folder=folder, budget=budget)
        study = WeightStudy.create(run.path, seed=0, rule="dirichlet", settings={}, trials=trials + events)
        for number in track(range(trials), "filling", "trials"):
            ticket = study.claim(trials)
            assert ticket is not None
            study.finish(ticket, outcome(number))
        study.write_table()
        lines = list(measure(study, trials, events))
        enlarge(study, large)
        lines.append((f"formctl search --status, of {large:,} trials", timed(5, lambda _: status(run.path))))
    cells = []
    for event, ms in lines:
        cells.append((event, len(ms), f"{sum(ms) / len(ms):.1f}", f"{sorted(ms)[int(0.95 * (len(ms) - 1))]:.1f}"))
    print_table(("event", "times", "ms each", "95 % under"), cells, title=f"a study of {trials:,} trials")


if __name__ == "__main__":
    typer.run(main)
