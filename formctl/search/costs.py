"""What the search's store costs: milliseconds per trial event, and seconds until a large study has told how it is."""

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from formctl.search import choosing, overview
from formctl.search.ledger import put
from formctl.search.study import Study
from formctl.search.trials import PARAMETERS, weights
from formctl.store import Run


@dataclass(frozen=True)
class Cost:
    """One line of the benchmark."""

    event: str
    trials: int  # in the study
    times: int
    milliseconds: float  # each, mean
    worst: float  # ms, of all but the slowest twentieth
    processor: float  # ms of processor time, each: what remains of it on a busy machine


def outcome(trial: int) -> dict[str, object]:
    """What a finished trial keeps, made up."""
    rate = (37 * trial % 1000) / 1000
    figures = {"sr": rate, "sr_k": int(200 * rate), "sr_n": 200, "cfr": rate, "fm": 0.3}
    figures |= {f"ok_{name}": rate for name in choosing.OBJECTIVES}
    place = {"seed": 0, "budget": 1_000_000, "steps": 1_000_000, "minutes": 3.0, "host": "bench"}
    return figures | place | {"run": f"trials/{trial:04d}", "policy": f"trials/{trial:04d}/policy.pt"}


def fill(study: Study, trials: int) -> None:
    """Finished trials, all in one transaction: the benchmark is about the next one."""
    ledger = study.ledger
    with ledger.event() as connection:
        for number in range(trials):
            vector = dict(zip(PARAMETERS, weights(0, number, "dirichlet"), strict=True))
            trial_id = ledger.insert(connection, number, vector)
            put(connection, "trial", trial_id, outcome(number))
            ledger.complete(connection, trial_id, "COMPLETE", float(outcome(number)["sr"]))  # type: ignore[arg-type]


def measure(folder: Path, trials: int, events: int) -> Iterator[Cost]:
    """Events on a study that has ``trials`` trials already; the study stays in ``folder``."""
    study = Study.create(folder, seed=0, rule="dirichlet", settings={}, trials=trials + events)
    fill(study, trials)
    claimed = []

    def claim() -> None:
        ticket = study.claim(trials + events)
        assert ticket is not None
        claimed.append(ticket)

    yield timed("claim: hand a trial out", trials, events, lambda _: claim())
    yield timed("report: a point of the learning curve", trials, events, lambda k: study.report(claimed[k], 1000, 0.5))
    yield timed("renew: a sign of life", trials, events, lambda k: study.ledger.renew(claimed[k].lease))
    study.write_table()  # which then waits for its turn: a twentieth of the time is the most it takes
    yield timed("finish: the outcome", trials, events, lambda k: study.finish(claimed[k], outcome(k)))
    yield timed("the table of all trials, rewritten", trials, 1, lambda _: study.write_table())
    yield timed("counts and best, for the record", trials, events, lambda _: overview.top(study.ledger, 1))


def timed(event: str, trials: int, times: int, act: Callable[[int], object]) -> Cost:
    """Do it ``times`` times."""
    took, before = [], processor_seconds()
    for number in range(times):
        begun = time.perf_counter()
        act(number)
        took.append(1000 * (time.perf_counter() - begun))
    used = 1000 * (processor_seconds() - before) / times
    return Cost(event, trials, times, sum(took) / times, sorted(took)[int(0.95 * (times - 1))], used)


def processor_seconds() -> float:
    """Processor time of this process and of those it waited for."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def status(run: Run, trials: int) -> Cost:
    """``formctl search --status`` on the study, as a process of its own, from start to end."""
    root = str(Path(__file__).resolve().parents[2])
    words = [f"name={run.path.parent.name}", f"runs={run.path.parents[2]}"]
    call = [sys.executable, "-m", "formctl", "search", "--status", *words]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])}

    def ask(_: int) -> None:
        subprocess.run(call, check=True, capture_output=True, env=environment)

    return timed("formctl search --status, the whole command", trials, 3, ask)
