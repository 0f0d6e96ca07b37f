"""Claim 8: the weights of the simplified task serve the full one, and smooth actions make unseen disturbances flyable.

The weights are judged by a policy trained with a trial's, the flights by the paper's own recipe, flown as it is.
"""

from typing import TYPE_CHECKING

import numpy as np

from analysis import commands, deployment, flown, methods, paper, series, stats, verdicts
from analysis.evidence import Evidence
from analysis.flown import Flown
from analysis.verdicts import Part, missing

if TYPE_CHECKING:
    import pandas as pd

TOLERANCE = 1e-6
"""Weights that differ by no more are the same."""

_WEIGHTS = ["w_formation", "w_flight", "w_obstacle", "w_action"]


def judge(evidence: Evidence) -> list[Part]:
    """Claim 8: from the simplified stage to the full one, and from there to flight."""
    return [_carried(evidence), *[_zero_shot(evidence, scenario) for scenario in deployment.SCENES]]


def _carried(evidence: Evidence) -> Part:
    """SR of a trial's weights in stage 1, and of the full method that was trained with them in the mixed scene."""
    found = series.study(evidence.store, evidence.profile)
    if found is None:
        return missing("SR of the weights in stage 1 and in stage 2", commands.search(evidence))
    run, trials = found
    for method in flown.full(evidence):
        trial = _trained_with(trials, method.facts.weights)
        rows = flown.episodes(evidence, method, "mixed", 10, 2)
        if trial is not None and rows is not None:
            simple, sr = _satisfied(trial), flown.rate(rows, "sr")
            seen = f"SR of the weights of trial {trial['trial']}: {simple.value:.3f} in stage 1, {sr.value:.3f} in the "
            seen += f"mixed scene ({simple.k}/{simple.n}, {sr.k}/{sr.n})"
            command = commands.more(evidence, ["scenario=mixed"], (method, rows))
            return Part(seen, verdicts.stays(verdicts.loss(simple, sr), verdicts.SLIGHT), command, sr.seeds)
    return missing("the full method trained with weights of stage 1", commands.carry_over(evidence, run.name))


def _trained_with(trials: "pd.DataFrame", weights: tuple[float, ...]) -> "pd.Series | None":
    """The trial whose weights these are; None where there is none."""
    if len(weights) != len(_WEIGHTS):
        return None
    same = trials[np.isclose(trials[_WEIGHTS].to_numpy(float), weights, rtol=0, atol=TOLERANCE).all(1)]
    return same.iloc[0] if len(same) else None


def _satisfied(trial: "pd.Series") -> stats.Rate:
    """A trial's SR: on fresh episodes where it was flown on some (the winner), since nobody chose it by those."""
    import pandas as pd

    fresh = pd.notna(trial.get("sr_fresh_k"))
    k, n = (int(trial[name]) for name in (("sr_fresh_k", "sr_fresh_n") if fresh else ("sr_k", "sr_n")))
    return stats.Rate(k, n, 1, *stats.wilson(k, n))


def _zero_shot(evidence: Evidence, scenario: str) -> Part:
    """One scene of the real flights: the full method in it; beside it, not judged, the policy trained for it."""
    published = paper.published("ours", scenario)
    assert published is not None
    trained = [method for method in evidence.methods.values() if method.facts.experiment == methods.FOR_FLIGHT]
    other = flown.deployed(evidence, scenario, trained)
    beside = f"{_ten_flights(evidence, scenario, other)}: trained for flight, not judged" if other else ""
    found = flown.deployed(evidence, scenario, flown.full(evidence))
    if found is None:
        what = f"simulated flights, {deployment.SCENES[scenario]}"
        return missing(what, deployment.command(evidence, "ours"), beside)
    smooth = flown.rate(found[1], "ok_action")
    able = deployment.summary(found[1]).most >= published.successes
    held = verdicts.every(able, verdicts.reaches(smooth.low, smooth.high, verdicts.GOOD))
    seen = f"{_ten_flights(evidence, scenario, found)}; paper {published.successes}"
    return Part(seen, held, deployment.command(evidence, "ours"), smooth.seeds, beside=beside)


def _ten_flights(evidence: Evidence, scenario: str, found: Flown) -> str:
    method, flights = found
    ten, smooth = deployment.summary(flights), flown.rate(flights, "ok_action")
    name = f"{deployment.SCENES[scenario]}, {evidence.names[method.key]}"
    return f"{name}: {ten.least} to {ten.most} of ten, smooth in {smooth.k}/{smooth.n}"
