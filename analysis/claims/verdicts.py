"""From checks to verdicts, and the table that shows them."""

from typing import NamedTuple

from analysis.claims.claims import CHECKS, CLAIMS, Check
from analysis.claims.measures import COUNTED, ENOUGH, Measured, NotMeasured
from analysis.data import lookup
from analysis.data.evidence import Evidence
from analysis.data.published import LEARNER
from analysis.stats import diversity
from analysis.tables.table import NOTHING, Cell, Column, Table

_COLUMNS = (
    Column("number", "No.", left=True),
    Column("claim", "The paper claims", left=True, wide=0.2),
    Column("verdict", "Verdict", left=True, wide=0.1),
    Column("check", "Checked", left=True, wide=0.13),
    Column("measured", "Measured here", left=True, wide=0.28),
    Column("limit", "Limit", left=True, wide=0.08),
    Column("holds", "Holds", left=True, wide=0.08),
)


class Outcome(NamedTuple):
    """A check and what came of it: whether it holds (None: open), what was seen, or what is lacking."""

    check: Check
    holds: bool | None
    seen: tuple[Measured, ...] = ()
    lacking: str = ""


def outcome(evidence: Evidence, check: Check) -> Outcome:
    """Measure and compare; of several figures all have to hold."""
    try:
        seen = tuple(check.measure(evidence))
    except NotMeasured as lacking:
        return Outcome(check, None, lacking=str(lacking))
    held = [holds(check, figure.low, figure.high) for figure in seen]
    return Outcome(check, False if False in held else None if None in held else True, seen)


def holds(check: Check, low: float, high: float) -> bool | None:
    """Whether a figure with this interval passes; None where the limit lies inside the interval."""
    limit = check.limit
    match check.comparison:
        case "≥" | "ahead":
            return True if low >= limit else False if high < limit else None
        case "≤":
            return True if high <= limit else False if low > limit else None
        case "<":
            return True if high < limit else False if low >= limit else None
        case "not below" | "not behind":
            return high >= limit
        case "not above":
            return low <= limit


def verdict(outcomes: list[Outcome]) -> str:
    """Of one claim, with what it rests on: another learner than the paper's, one training seed."""
    held = [each.holds for each in outcomes]
    if False in held:
        text = "not confirmed"
    elif None in held:
        return "not yet measured" if any(each.lacking for each in outcomes) else "open: too few episodes"
    else:
        text = "confirmed"
    seen = [figure for each in outcomes for figure in each.seen]
    learners = sorted({figure.learner for figure in seen if figure.learner})
    other = [f"with {', '.join(name.upper() for name in learners)}"] if learners and learners != [LEARNER] else []
    single = ["one seed"] if max((figure.seeds for figure in seen), default=0) == 1 else []
    return text + (f" ({', '.join([*other, *single])})" if other or single else "")


def table(evidence: Evidence) -> Table:
    """The claims page: a row for every check, the verdict with a claim's first."""
    rows: list[tuple[Cell, ...]] = []
    starts = []
    for number, (claim, section) in CLAIMS.items():
        outcomes = [outcome(evidence, check) for check in CHECKS if check.claim == number]
        starts.append(len(rows))
        text = verdict(outcomes)
        value = {"confirmed": 1.0, "not confirmed": 0.0}.get(text.partition(" (")[0])
        first = (Cell(str(number)), Cell(claim, (f"Sec. {section}",)), Cell(text, value=value))
        heads = [first, *[(Cell(""),) * 3] * (len(outcomes) - 1)]
        rows += [(*head, *_cells(each)) for head, each in zip(heads, outcomes, strict=True)]
    apart = ", ".join(quantity.words(quantity.apart) for quantity in diversity.QUANTITIES)
    parts = (
        "A limit without a place in the paper is ours. ≥, ≤ and <: the whole 95 % interval lies there; not below, not "
        "above: a part of it does. Ahead: exact McNemar test on shared episodes, p < 0.05, Holm-adjusted over those "
        "that one is held against, with several seeds for each of them. A verdict is about the learner and the seeds "
        f"that it names; the paper's statements are about {LEARNER.upper()}. Equal SR: not told from the best trial's; "
        f"another style: means with intervals that do not meet, at least this far apart: {apart}. Of the trials those "
        f"count whose weights are all at least {COUNTED:g}; of a learnt baseline, from {ENOUGH:.0%} of its published "
        "training on.",
        evidence.satisfaction(evidence.cells),
    )
    notes = _other_recipe(evidence)
    caption, stamp = " ".join(filter(None, parts)), evidence.stamp(evidence.cells)
    return Table("claims", "The paper's claims", caption, _COLUMNS, tuple(rows), stamp, notes, tuple(starts))


def _other_recipe(evidence: Evidence) -> tuple[str, ...]:
    ours, flights = lookup.ours(evidence)
    if ours is None or flights is None or ours.role == "ours":
        return ()
    return (
        "The paper's full method, with weights from a search, has not been flown in the main scene. What is said of "
        f"our policy is said of {evidence.names[ours.key]}.",
    )


def _cells(each: Outcome) -> tuple[Cell, ...]:
    check = each.check
    lines = [figure.text for figure in each.seen] or [f"not measured: {each.lacking}" if each.lacking else NOTHING]
    compared = check.comparison if check.comparison[:1] == "a" or "behind" in check.comparison else ""
    limit = compared or f"{check.comparison} {check.limit:g}"
    source = () if compared or check.source == "ours" else (check.source,)
    words = {True: "yes", False: "no", None: "not measured" if each.lacking else "open"}
    return Cell(check.what), Cell(lines[0], tuple(lines[1:])), Cell(limit, source), Cell(words[each.holds])
