"""The paper's eight claims, what was measured about each, and what follows.

A claim is made of parts. It is confirmed when all of them hold, not confirmed when a measured one fails, and not yet
measured otherwise. What counts as "slight", "sharp" or "good" is nowhere said in the paper: the constants below are
ours, fixed here, and are printed with the verdict.
"""

from collections.abc import Callable
from typing import NamedTuple

from analysis import cells, commands, deployment, diversity, flown, methods, paper, series, styles
from analysis.behaviour import RECORD
from analysis.cells import Cell, Column, Table
from analysis.evidence import Evidence
from analysis.methods import Method

SLIGHT = 0.10
"""CFR lost over a sweep that still is slight degradation."""
SHARP = 0.20
"""CFR lost over a sweep that is a sharp drop."""
GOOD = 0.80
"""A rate from here on is good."""
TIGHTER = 3.0
"""Ratio of FM (Swarm-RL over ours) that the paper's table shows at least."""
VARIES = 0.30
"""Range of SR over random weights that is strong variation."""
ENOUGH = 0.10
"""Share of its published training from which on a learnt baseline counts."""

_COLUMNS = (
    Column("number", "No.", left=True),
    Column("claim", "The paper claims", left=True, wide=0.32),
    Column("measured", "Measured here", left=True, wide=0.34),
    Column("verdict", "Verdict", left=True, wide=0.22),
)


class Part(NamedTuple):
    """One checkable piece of a claim: what was seen, whether it holds (None: not measured), what would measure it."""

    seen: str
    holds: bool | None
    command: str = ""


def table(evidence: Evidence) -> Table:
    """The claims page."""
    rows = tuple(_row(number, claim, judge(evidence)) for number, (claim, judge) in enumerate(CLAIMS, start=1))
    apart = ", ".join(quantity.tell(quantity.apart) for quantity in diversity.QUANTITIES)
    caption = (
        f"Slight: at most {SLIGHT:.2f} of CFR lost; sharp: at least {SHARP:.2f}; good: a rate from {GOOD:.2f}; strong "
        f"variation: SR over a range of {VARIES:.2f}; slower: by {styles.SLOWER:g} m/s, every drone; resumed: "
        f"{styles.RESUMED:.0%} of the speed before; shifted: {styles.SHIFTED:g} m; twisted slightly: FM up to "
        f"{styles.SLIGHTLY:g} m. Equal SR: the interval reaches that of the best trial; styles: means with intervals "
        f"that do not meet, at least this far apart: {apart}. A learnt baseline counts from {ENOUGH:.0%} of its "
        "published training on. The constants are ours, the paper gives none."
    )
    ours, flights = flown.ours(evidence)
    notes: tuple[str, ...] = ()
    if ours is not None and flights is not None and ours.role != "ours":
        notes = (
            f"The paper's own recipe has not been flown in the main scene. What is said of our policy is said of "
            f"{evidence.names[ours.key]}: the paper's network, trained another way.",
        )
    return Table("claims", "The paper's claims", caption, _COLUMNS, rows, evidence.stamp(evidence.cells), notes)


def _row(number: int, claim: str, parts: list[Part]) -> tuple[Cell, ...]:
    found = [part for part in parts if part.holds is not None]
    seen = [f"{part.seen}{'' if part.holds else ' (fails)'}" for part in found]
    measured = Cell(seen[0], tuple(seen[1:])) if seen else Cell(cells.NOTHING)
    command = next((part.command for part in parts if part.holds is None and part.command), "")
    if any(part.holds is False for part in parts):
        verdict = Cell("not confirmed", value=0.0)
    elif len(found) == len(parts):
        verdict = Cell("confirmed", value=1.0)
    else:
        verdict = Cell("not yet measured", tuple(part.seen for part in parts if part.holds is None), command=command)
    return Cell(str(number)), Cell(claim), measured, verdict


def main_scene(evidence: Evidence) -> list[Part]:
    """Claim 1, against Table I."""
    ours, rows = flown.ours(evidence)
    if ours is None or rows is None:
        return [Part("the full method in the mixed scene", None, _measure_ours(evidence))]
    published = paper.published("ours", "mixed")
    assert published is not None and published.fm is not None
    rate, fm = flown.rate(rows), flown.fm(rows)
    text = f"{evidence.names[ours.key]}: CFR {rate.value:.3f} [{rate.low:.3f}, {rate.high:.3f}], paper {published.cfr}"
    parts = [Part(text, rate.high >= published.cfr)]
    if fm is None:
        return [*parts, Part("no success, so no FM", False)]
    parts.append(
        Part(f"FM {fm.value:.3f} m [{fm.low:.3f}, {fm.high:.3f}], paper {published.fm}", fm.low <= published.fm)
    )
    other = flown.named(evidence, "swarm_rl")
    if (barely := _barely_trained(other)) is not None:
        return [*parts, barely]
    theirs = flown.episodes(evidence, other, "mixed", 10, 2)
    if theirs is None or (their_fm := flown.fm(theirs)) is None:
        return [*parts, Part("Swarm-RL in the mixed scene", None, _measure(evidence, "swarm_rl", "scenario=mixed"))]
    similar = rate.high >= flown.rate(theirs).value
    ratio = their_fm.value / fm.value
    return [*parts, Part(f"Swarm-RL: FM {ratio:.1f} times ours", similar and ratio >= TIGHTER)]


def sweeps(evidence: Evidence) -> list[Part]:
    """Claim 2: zero-shot to more obstacles."""
    ours, _ = flown.ours(evidence)
    parts = []
    for axis, (low, high) in _ENDS.items():
        ends = [flown.swept(evidence, ours, axis, count) for count in (low, high)]
        command = commands.fly(evidence, ours, _GRIDS[axis]()) if ours else _measure_ours(evidence)
        if ends[0] is None or ends[1] is None:
            parts.append(Part(f"{low} to {high} {axis}", None, command))
            continue
        first, last = (flown.rate(end) for end in ends if end is not None)
        ends_text = " to ".join(f"{end.value:.3f} ({end.k}/{end.n})" for end in (first, last))
        seen = f"{low} to {high} {axis}: CFR {ends_text}"
        parts.append(Part(seen, first.value - last.value <= SLIGHT))
        rivals = {m: flown.swept(evidence, m, axis, high) for m in evidence.methods.values() if m.role == "baseline"}
        able = {evidence.names[m.key]: flown.rate(rows).value for m, rows in rivals.items() if rows is not None}
        if able:
            best = max(able, key=lambda name: able[name])
            parts.append(Part(f"{high} {axis}: {best} {able[best]:.3f}", last.high >= able[best]))
        else:
            parts.append(Part(f"baselines at {high} {axis}", None, _measure(evidence, "swarm_rl", *_GRIDS[axis]())))
    return parts


def swarm_rl(evidence: Evidence) -> list[Part]:
    """Claim 3: what the learnt baseline is good and bad at."""
    other, (_, ours_rows) = flown.named(evidence, "swarm_rl"), flown.ours(evidence)
    if (barely := _barely_trained(other)) is not None:
        return [barely]
    static = flown.swept(evidence, other, "columns", 10)
    few, many = (flown.swept(evidence, other, "balls", count) for count in _ENDS["balls"])
    mixed = flown.episodes(evidence, other, "mixed", 10, 2)
    parts = []
    if static is None:
        command = _measure(evidence, "swarm_rl", *commands.columns_sweep())
        parts.append(Part("Swarm-RL among columns", None, command))
    else:
        parts.append(Part(f"static CFR {flown.rate(static).value:.3f}", flown.rate(static).high >= GOOD))
    if mixed is None or ours_rows is None or (a := flown.fm(mixed)) is None or (b := flown.fm(ours_rows)) is None:
        command = _measure(evidence, "swarm_rl", "scenario=mixed") if mixed is None else _measure_ours(evidence)
        parts.append(Part("formation of Swarm-RL beside ours", None, command))
    else:
        parts.append(Part(f"FM {a.value:.3f} m, ours {b.value:.3f} m", a.low > b.high))
    if few is None or many is None:
        command = _measure(evidence, "swarm_rl", *commands.balls_sweep())
        return [*parts, Part("Swarm-RL against more balls", None, command)]
    drop = flown.rate(few).value - flown.rate(many).value
    return [*parts, Part(f"CFR falls by {drop:.3f} from 1 to 5 balls", drop >= SHARP)]


def _barely_trained(learnt: Method | None) -> Part | None:
    """What is missing where a learnt baseline has had so little of its published training that it proves nothing."""
    if learnt is None or not learnt.facts.steps or not learnt.facts.published_steps:
        return None
    share = learnt.facts.steps / learnt.facts.published_steps
    command = f"formctl train experiment={learnt.facts.name} train.steps={learnt.facts.published_steps}"
    seen = f"{methods.LABELS[learnt.facts.name]}: {share:.0%} of its published training"
    return Part(seen, None, command) if share < ENOUGH else None


def encoder(evidence: Evidence) -> list[Part]:
    """Claim 4: only the full encoder is good on all objectives."""
    parts = []
    for name, label in methods.ENCODERS.items():
        rows = flown.arm(evidence, name, "three_period")
        if rows is None:
            parts.append(Part(label, None, commands.train_and_fly(evidence, name, "three_period")))
            continue
        worst = min(_OBJECTIVES, key=lambda objective: rows[f"ok_{objective}"].mean())
        share = float(rows[f"ok_{worst}"].mean())
        parts.append(Part(f"{label}: least {worst} {share:.2f}", (share >= GOOD) == (name == "attention")))
    return parts


def curriculum(evidence: Evidence) -> list[Part]:
    """Claim 5: the curriculum at equal data."""
    ours = flown.arm(evidence, "attention", "three_period")
    parts = []
    for name, label in methods.CURRICULA.items():
        rows = flown.arm(evidence, "attention", name)
        if rows is None or ours is None:
            parts.append(Part(label, None, commands.train_and_fly(evidence, "attention", name)))
        elif name != "three_period":
            mine, other = flown.rate(ours, "sr"), flown.rate(rows, "sr")
            seen = f"SR {mine.value:.3f} [{mine.low:.3f}, {mine.high:.3f}], {label} {other.value:.3f}"
            parts.append(Part(f"{seen} [{other.low:.3f}, {other.high:.3f}]", mine.low > other.high))
    dynamic = flown.arm(evidence, "attention", "three_period_dynamic")
    if dynamic is not None and ours is not None:
        in_time = flown.rate(dynamic, "ok_flight"), flown.rate(ours, "ok_flight")
        seen = f"in time: {in_time[1].value:.3f}, dynamic-only {in_time[0].value:.3f}"
        parts.append(Part(seen, in_time[0].high < in_time[1].value))
    return parts


def weights(evidence: Evidence) -> list[Part]:
    """Claim 6: random weights decide, and equal rates hide different styles."""
    command = commands.search(evidence.profile)
    found = series.study(evidence.store, evidence.profile)
    if found is None:
        return [Part(seen, None, command) for seen in ("SR over random weights", "styles of weights with equal SR")]
    run, trials = found
    least, most = trials.iloc[-1], trials.iloc[0]
    apart = most["sr"] - least["sr"] >= VARIES and most["sr_low"] > least["sr_high"]
    parts = [Part(f"SR {least['sr']:.3f} to {most['sr']:.3f} over {len(trials)} trials", bool(apart))]
    styles = diversity.table(run, trials)
    if not (spread := diversity.spread(styles)):
        return [*parts, Part("styles of weights with equal SR", None, command)]
    equal = styles[styles["equal"]]
    ranges = ", ".join(quantity.tell(low, high) for quantity, low, high, other in spread if other)
    seen = f"{len(equal)} trials of equal SR ({equal['sr'].min():.3f} to {equal['sr'].max():.3f}): "
    return [*parts, Part(seen + (ranges or "all of one style"), bool(ranges))]


def behaviour(evidence: Evidence) -> list[Part]:
    """Claim 7: rows hold means only; speed and shape are read from the recorded flights of the behaviour pictures."""
    ours, _ = flown.ours(evidence)
    if ours is None:
        return [Part("recorded flights of the full method", None, _measure_ours(evidence))]
    among = styles.recorded(evidence, ours, "fixed4")
    under = styles.recorded(evidence, ours, "dynamic")
    parts = []
    if among is None or (passage := styles.passage(among)) is None:
        command = commands.fly(evidence, ours, ["scenario=fixed4", RECORD])
        parts.append(Part("a recorded flight among columns", None, command))
    else:
        seen = f"one flight: centroid {passage.shift:.2f} m aside, FM at most {passage.error:.2f} m"
        parts.append(Part(seen, passage.as_told))
    if under is None or not (dodges := styles.dodges(under)):
        command = commands.fly(evidence, ours, ["scenario=dynamic", RECORD])
        return [*parts, Part("a recorded flight under balls", None, command)]
    for dodge in dodges:
        seen = f"one throw: {dodge.before:.2f} m/s before, {dodge.least:.2f} at least, {dodge.after:.2f} after"
        parts.append(Part(seen, dodge.as_told))
    return parts


def transfer(evidence: Evidence) -> list[Part]:
    """Claim 8: from the simplified stage to the full one, and from there to flight."""
    ours, rows = flown.ours(evidence)
    found = series.study(evidence.store, evidence.profile)
    parts = []
    if found is None or ours is None or rows is None:
        command = commands.search(evidence.profile) if found is None else _measure_ours(evidence)
        parts.append(Part("SR of the weights in stage 1 and in stage 2", None, command))
    else:
        best, sr = found[1].iloc[0], flown.rate(rows, "sr")
        seen = f"SR {best['sr']:.3f} in stage 1, {sr.value:.3f} in the mixed scene"
        parts.append(Part(seen, best["sr"] - sr.high <= SLIGHT))
    for scenario, title in deployment.SCENES.items():
        published = paper.published("ours", scenario)
        disturbed = flown.deployed(evidence, scenario)
        assert published is not None
        if disturbed is None:
            parts.append(Part(f"simulated flights, {title}", None, deployment.command(evidence, "ours")))
            continue
        flyer, flights = disturbed
        seen_here = deployment.summary(flights)
        text = f"{title}, {evidence.names[flyer.key]}: {seen_here.least} to {seen_here.most} of ten, "
        text += f"paper {published.successes}"
        parts.append(Part(text, seen_here.most >= published.successes))
    return parts


CLAIMS: tuple[tuple[str, Callable[[Evidence], list[Part]]], ...] = (
    ("Mixed scene: CFR about 0.89 with FM about 0.28; FM at least 3 times better than Swarm-RL's", main_scene),
    ("From 5 to 20 columns and 1 to 5 balls only slightly worse; no baseline is better at the extremes", sweeps),
    ("Swarm-RL: high static CFR, poor formation, a sharp drop of CFR with more balls", swarm_rl),
    ("Encoder: only the full model is good on all objectives", encoder),
    ("Curriculum: ours is best at equal data; dynamic-only pre-training misses the goal in time", curriculum),
    ("Reward weights: SR varies strongly; equal SR, different styles of dodging", weights),
    ("Near columns the formation shifts and twists slightly; before a ball it slows down together", behaviour),
    ("The weights of the simplified task transfer; smooth actions make zero-shot real flight possible", transfer),
)
"""Each claim (method facts of the paper's Sec. VI) and what judges it."""

_OBJECTIVES = ("formation", "flight", "obstacle", "action")
_ENDS: dict[series.Axis, tuple[int, int]] = {"columns": (5, 20), "balls": (1, 5)}
_GRIDS: dict[series.Axis, Callable[[], list[str]]] = {
    "columns": commands.columns_sweep,
    "balls": commands.balls_sweep,
}


def _measure_ours(evidence: Evidence) -> str:
    return commands.train_and_fly(evidence, "attention", "three_period")


def _measure(evidence: Evidence, name: str, *words: str) -> str:
    return commands.fly_baseline(evidence, name, list(words))
