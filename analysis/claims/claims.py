"""The paper's eight claims as a table: what is claimed, what measures it, how it is compared, with which limit.

A claim is confirmed when all of its checks hold, not confirmed when one fails, and open otherwise: something was not
flown, or an interval leaves the limit open. What counts as "slight", "sharp" or "good" is nowhere said in the paper:
limits that do not come from it are ours, and stand beside every verdict.
"""

from collections.abc import Mapping
from typing import Literal, NamedTuple

from analysis.claims.measures import (
    Measure,
    Scene,
    carried,
    change,
    fm_ratio,
    gap,
    level,
    paired,
    passage,
    range_over_weights,
    rates_over_weights,
    real_flights,
    resumed,
    styles_of_equal_rate,
)
from analysis.data.lookup import MAIN
from analysis.data.published import CURRICULA, ENCODERS, REAL_SCENES
from analysis.stats.paired import ALPHA

Comparison = Literal["≥", "≤", "<", "not below", "not above", "ahead", "not behind"]
"""≥, ≤ and <: the whole interval lies there; not below, not above: a part of it does; ahead, not behind: by the exact
McNemar test on shared episodes, Holm-adjusted, p < 0.05."""

CLAIMS: Mapping[int, tuple[str, str]] = {
    1: ("Mixed scene: CFR 0.89 with FM 0.278 m, and a formation three times tighter than Swarm-RL's", "VI-A2"),
    2: ("CFR and FM only slightly worse from 5 to 20 columns and 1 to 5 balls, no baseline better there", "VI-A2"),
    3: ("Swarm-RL: high CFR among columns, poor formation, a sharp drop of CFR with more balls", "VI-A2"),
    4: ("Only the full encoder is good at all objectives", "VI-C1"),
    5: ("The curriculum is best at equal data; static first also helps against balls, balls first is late", "VI-C2"),
    6: ("SR depends strongly on the reward weights; equal SR hides different styles of dodging", "VI-B"),
    7: ("Near columns the formation shifts and twists slightly; before a ball it slows down together", "VI-A3"),
    8: ("Weights of the simplified task serve the full one; smooth actions make real flight possible", "VI-D"),
}
"""What the paper claims, and its section."""

SLIGHT, SLIGHT_FM, SHARP, GOOD, TIGHTER = 0.10, 0.10, 0.20, 0.80, 3.0
"""Our limits: of a rate lost, of FM gained (m), of CFR lost sharply, of a good rate, of the ratio of two FM."""


class Check(NamedTuple):
    """One row of the table: a figure that decides a part of a claim."""

    claim: int
    what: str
    measure: Measure
    comparison: Comparison
    limit: float = 0.0
    source: str = "ours"  # of the limit: ours, or a place in the paper


def _columns(count: int) -> Scene:
    return "static", count, 0


def _balls(count: int) -> Scene:
    return "dynamic", 0, count


_OTHERS = [f"curriculum={name}" for name in CURRICULA if name != "three_period"]

CHECKS: tuple[Check, ...] = (
    Check(1, "CFR", level("ours", MAIN, "cfr"), "not below", 0.89, "Table I"),
    Check(1, "FM (m)", level("ours", MAIN, "fm"), "not above", 0.278, "Table I"),
    Check(1, "CFR beside Swarm-RL's", paired("ours", ["swarm_rl"], MAIN), "not behind"),
    Check(1, "FM, ratio", fm_ratio("swarm_rl", "ours", MAIN), "≥", TIGHTER, "Table I"),
    Check(2, "CFR lost, 5 to 20 columns", change("ours", _columns(5), _columns(20), "cfr"), "≤", SLIGHT),
    Check(2, "FM gained (m), 5 to 20 columns", change("ours", _columns(5), _columns(20), "fm"), "≤", SLIGHT_FM),
    Check(2, "CFR at 20 columns", paired("ours", ["baselines"], _columns(20)), "ahead"),
    Check(2, "CFR lost, 1 to 5 balls", change("ours", _balls(1), _balls(5), "cfr"), "≤", SLIGHT),
    Check(2, "FM gained (m), 1 to 5 balls", change("ours", _balls(1), _balls(5), "fm"), "≤", SLIGHT_FM),
    Check(2, "CFR at 5 balls", paired("ours", ["baselines"], _balls(5)), "ahead"),
    Check(3, "CFR, 10 columns", level("swarm_rl", _columns(10), "cfr"), "≥", GOOD),
    Check(3, "FM (m) above ours", gap("swarm_rl", "ours", MAIN, "fm"), "≥", 0.0),
    Check(3, "CFR lost, 1 to 5 balls", change("swarm_rl", _balls(1), _balls(5), "cfr"), "≥", SHARP),
    *(
        Check(4, name, level(f"encoder={arm}", MAIN, "least objective"), "≥" if arm == "attention" else "<", GOOD)
        for arm, name in ENCODERS.items()
    ),
    Check(5, "SR", paired("curriculum=three_period", _OTHERS, MAIN, "sr"), "ahead"),
    Check(5, "no ball hit", paired("curriculum=three_period", _OTHERS, MAIN, "unhit"), "ahead"),
    Check(
        5,
        "flight objective above that of balls first",
        gap("curriculum=three_period", "curriculum=three_period_dynamic", MAIN, "ok_flight"),
        "≥",
        SLIGHT,
    ),
    Check(6, "one SR for all (chi-squared p)", rates_over_weights, "<", ALPHA),
    Check(6, "range of SR", range_over_weights, "≥", 0.30),
    Check(6, "styles at equal SR (quantities)", styles_of_equal_rate, "≥", 1),
    Check(7, "shift of the centroid (m)", passage("shift"), "≥", 0.1),
    Check(7, "twist, FM at its worst (m)", passage("error"), "≤", 0.5),
    Check(7, "slowing down together", resumed, "≥", 0.5),
    Check(8, "SR lost from stage 1 to 2", carried, "≤", SLIGHT),
    *(
        Check(8, f"flights, {scene}", real_flights(scene, "successes"), "not below", 0, "Table II")
        for scene in REAL_SCENES
    ),
    *(Check(8, f"smoothness, {scene}", real_flights(scene, "smooth"), "≥", GOOD) for scene in REAL_SCENES),
)
"""Every check of every claim, in order."""
