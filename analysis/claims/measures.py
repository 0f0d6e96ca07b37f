"""What a claim is measured by: a figure with its interval, of methods and scenes that the table of claims names.

A measure is a function of the evidence. It gives one ``Measured`` for every method asked for, or raises
``NotMeasured`` with what is lacking.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from analysis import stats
from analysis.data import lookup, published, recorded
from analysis.data.evidence import Evidence
from analysis.data.methods import SAME, Method
from analysis.data.rows import WEIGHTS
from analysis.stats import Mean, Rate, diversity, dodging
from analysis.stats.paired import difference
from analysis.tables import deployment
from envs.vocabulary import OBJECTIVES

ENOUGH = 0.10
"""Share of its published training from which on a learnt baseline counts."""
COUNTED = 0.05
"""Least weight of every objective with which a trial counts as a choice among four."""

Scene = tuple[str, int, int]
"""Scenario, columns, balls."""


class Measured(NamedTuple):
    """What was seen, and the interval of the figure that is held against a limit."""

    text: str
    low: float
    high: float
    seeds: int = 0  # training seeds behind it, of the policy that has most
    learner: str = ""  # of our policy behind it


class NotMeasured(Exception):
    """What was not flown, or does not count."""


class Subject(NamedTuple):
    """Somebody's episodes in a scene."""

    method: Method
    name: str
    rows: pd.DataFrame

    @property
    def seeds(self) -> int:
        """Training seeds; 0 for a planner."""
        return self.rows["train_seed"].nunique() if self.method.facts.learnt else 0

    @property
    def learner(self) -> str:
        """Of a policy of ours."""
        return self.method.facts.algo if self.method.policy else ""


Measure = Callable[[Evidence], list[Measured]]


def level(who: str, scene: Scene, metric: str) -> Measure:
    """A rate or FM in a scene. ``metric``: a flag of the rows, ``fm``, or ``least objective``."""

    def measure(evidence: Evidence) -> list[Measured]:
        subject = _subject(evidence, who, scene)
        name, figure = _figure(subject.rows, metric)
        text = f"{subject.name}: {name} {_told(figure)}"
        return [Measured(text, figure.low, figure.high, subject.seeds, subject.learner)]

    return measure


def change(who: str, first: Scene, last: Scene, metric: str) -> Measure:
    """By how much a figure is lower in the last scene than in the first; FM: higher."""

    def measure(evidence: Evidence) -> list[Measured]:
        ends = [_subject(evidence, who, scene) for scene in (first, last)]
        before, after = (_figure(end.rows, metric)[1] for end in ends)
        lost = difference(after, before) if metric == "fm" else difference(before, after)
        text = f"{ends[0].name}: {metric.upper()} {_told(before)} to {_told(after)}"
        return [Measured(text, lost.low, lost.high, ends[1].seeds, ends[1].learner)]

    return measure


def gap(who: str, other: str, scene: Scene, metric: str) -> Measure:
    """By how much the first method's figure exceeds the other's."""

    def measure(evidence: Evidence) -> list[Measured]:
        one, two = _subject(evidence, who, scene), _subject(evidence, other, scene)
        (name, a), (_, b) = (_figure(subject.rows, metric) for subject in (one, two))
        apart = difference(a, b)
        text = f"{name}: {one.name} {_told(a)}, {two.name} {_told(b)}"
        return [Measured(text, apart.low, apart.high, max(one.seeds, two.seeds), one.learner or two.learner)]

    return measure


def fm_ratio(who: str, other: str, scene: Scene) -> Measure:
    """FM of the first method over that of the other."""

    def measure(evidence: Evidence) -> list[Measured]:
        one, two = _subject(evidence, who, scene), _subject(evidence, other, scene)
        (_, a), (_, b) = (_figure(subject.rows, "fm") for subject in (one, two))
        text = f"FM of {one.name} {a.value / b.value:.1f} times that of {two.name}"
        return [Measured(text, a.low / b.high, a.high / b.low, two.seeds, two.learner)]

    return measure


def paired(who: str, others: Sequence[str], scene: Scene, flag: str = "cfr") -> Measure:
    """Whether the first method is ahead (1), behind (-1) or not told from each of the others, on shared episodes.

    ``others``: names, or ``baselines`` for all of those that count.
    """

    def measure(evidence: Evidence) -> list[Measured]:
        one = _subject(evidence, who, scene, flag)
        rivals = _baselines(evidence, scene) if "baselines" in others else []
        rivals += [_subject(evidence, other, scene, flag) for other in others if other != "baselines"]
        tests = stats.compare(one.rows, [rival.rows for rival in rivals], flag)
        found = []
        for rival, test in zip(rivals, tests, strict=True):
            own, theirs = (stats.rate_of(subject.rows, flag) for subject in (one, rival))
            text = f"{one.name} {own.k}/{own.n}, {rival.name} {theirs.k}/{theirs.n}; {test}"
            low, high = {True: (1, 1), False: (-1, -1), None: (-1, 1)}[test.ahead]
            found.append(Measured(text, low, high, max(one.seeds, rival.seeds), one.learner))
        return found

    return measure


def _subject(evidence: Evidence, who: str, scene: Scene, flag: str = "") -> Subject:
    """``ours``, a baseline of the paper, or an arm: ``encoder=mlp``, ``curriculum=none``. Raises NotMeasured."""
    group, is_arm, choice = who.partition("=")
    if is_arm:
        arm = lookup.arm(evidence, **{"encoder": "attention", "curriculum": "three_period"} | {group: choice})
        method, rows = arm or (None, None)
        arms = published.ENCODERS if group == "encoder" else published.CURRICULA
        name = arms[choice]
    else:
        method = lookup.ours(evidence)[0] if who == "ours" else lookup.named(evidence, who)
        rows = lookup.episodes(evidence, method, *scene)
        name = published.METHODS[who] if method is None else evidence.names[method.key]
        if method is not None and who != "ours":
            _counts(method, name)
    if method is None or rows is None:
        raise NotMeasured(f"{name}, {_place(scene)}")
    return Subject(method, name, rows.assign(unhit=~rows["hit_ball"].astype(bool)) if flag == "unhit" else rows)


def _baselines(evidence: Evidence, scene: Scene) -> list[Subject]:
    """Baselines that count, with their episodes. Raises NotMeasured where there is none."""
    found = []
    for method in evidence.methods.values():
        rows = lookup.episodes(evidence, method, *scene)
        if not method.policy and method.role != "sanity" and rows is not None and _share(method) >= ENOUGH:
            found.append(Subject(method, evidence.names[method.key], rows))
    if not found:
        raise NotMeasured(f"baselines, {_place(scene)}")
    return found


def _counts(method: Method, name: str) -> None:
    """Raises NotMeasured for a learnt baseline that has had too little of its published training."""
    if _share(method) < ENOUGH:
        raise NotMeasured(f"{name}: {_share(method):.0%} of its published training, from {ENOUGH:.0%} on it counts")


def _share(method: Method) -> float:
    facts = method.facts
    return facts.steps / facts.published_steps if facts.steps and facts.published_steps else 1.0


def _place(scene: Scene) -> str:
    scenario, columns, balls = scene
    return {"static": f"{columns} columns", "dynamic": f"{balls} balls"}.get(scenario, f"{scenario} scene")


def _figure(rows: pd.DataFrame, metric: str) -> tuple[str, Rate | Mean]:
    """A figure's name and value. Raises NotMeasured for FM without a success."""
    if metric == "fm":
        if (fm := stats.fm_of(rows)) is None:
            raise NotMeasured("no success, so no FM")
        return "FM", fm
    if metric == "least objective":
        worst = min(OBJECTIVES, key=lambda objective: float(rows[f"ok_{objective}"].mean()))
        return f"least {worst}", stats.rate_of(rows, f"ok_{worst}")
    return metric.removeprefix("ok_").upper() if metric == "cfr" else metric, stats.rate_of(rows, metric)


def _told(figure: Rate | Mean) -> str:
    if isinstance(figure, Rate):
        return f"{figure.value:.3f} ({figure.k}/{figure.n})"
    return f"{figure.value:.3f} m"


def _trials(evidence: Evidence) -> tuple[lookup.Run, pd.DataFrame]:
    study = lookup.study(evidence)
    if study is None:
        raise NotMeasured("a study of random weights")
    return study


def rates_over_weights(evidence: Evidence) -> list[Measured]:
    """The p value that all trials whose weights are all at least ``COUNTED`` have one and the same SR."""
    _, trials = _trials(evidence)
    counted = trials[(trials[list(WEIGHTS)].to_numpy(float) >= COUNTED).all(1)]
    if len(counted) < 2:
        raise NotMeasured(f"two trials with all weights from {COUNTED:g} on")
    p = stats.heterogeneity(counted["sr_k"], counted["sr_n"])
    shown = "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
    return [Measured(f"{len(counted)} trials with all weights from {COUNTED:g} on, one SR: {shown}", p, p)]


def range_over_weights(evidence: Evidence) -> list[Measured]:
    """Difference of the highest and the lowest SR among the same trials."""
    _, trials = _trials(evidence)
    counted = trials[(trials[list(WEIGHTS)].to_numpy(float) >= COUNTED).all(1)]
    if len(counted) < 2:
        raise NotMeasured(f"two trials with all weights from {COUNTED:g} on")
    low, high = float(counted["sr"].min()), float(counted["sr"].max())
    return [Measured(f"SR {low:.3f} to {high:.3f} over {len(counted)} trials", high - low, high - low)]


def styles_of_equal_rate(evidence: Evidence) -> list[Measured]:
    """How many quantities tell the trials apart whose SR is not told from the best one's."""
    run, trials = _trials(evidence)
    styles = diversity.table(run, diversity.with_intervals(trials))
    spread = diversity.spread(styles)
    if not spread:
        raise NotMeasured("two trials of equal SR")
    equal = styles[styles["equal"]]
    apart = [quantity.words(low, high) for quantity, low, high, other in spread if other]
    text = f"{len(equal)} trials of equal SR ({equal['sr'].min():.3f} to {equal['sr'].max():.3f}): "
    return [Measured(text + (", ".join(apart) or "all of one style"), len(apart), len(apart))]


def passage(quantity: str) -> Measure:
    """Of one recorded flight among columns: how far the centroid shifts (``shift``), or FM at its worst (``error``)."""

    def measure(evidence: Evidence) -> list[Measured]:
        method = lookup.ours(evidence)[0]
        flights = recorded.of_method(evidence, method, "fixed4")[-1:] if method else []  # columns always stand the same
        passages = [found for flight in flights if (found := dodging.passage(flight)) is not None]
        if method is None or not passages:
            raise NotMeasured("a recorded flight among columns")
        value = getattr(passages[0], quantity)
        words = {"shift": "centroid {:.2f} m aside", "error": "FM at most {:.2f} m"}[quantity]
        return [Measured(f"one flight: {words.format(value)}", value, value, 1, method.facts.algo)]

    return measure


def resumed(evidence: Evidence) -> list[Measured]:
    """Share of the recorded throws at which all drones slow down together, then resume."""
    method = lookup.ours(evidence)[0]
    flights = recorded.of_method(evidence, method, "dynamic") if method else []
    throws = [dodge for flight in flights for dodge in dodging.dodges(flight)]
    if method is None or not throws:
        raise NotMeasured("recorded flights under balls")
    share = stats.rate([dodge.resumed for dodge in throws])
    before, least, after = (f"{speed:.2f}" for speed in np.mean([dodge[:3] for dodge in throws], 0))
    text = (
        f"at {share.k} of {share.n} throws [{share.low:.2f}, {share.high:.2f}]; on average {before} m/s before, "
        f"{least} at least, {after} after"
    )
    return [Measured(text, share.low, share.high, 1, method.facts.algo)]


def carried(evidence: Evidence) -> list[Measured]:
    """SR that the weights of a trial lose from stage 1 to the full method trained with them, in the main scene."""
    _, trials = _trials(evidence)
    for method in lookup.full(evidence):
        rows = lookup.episodes(evidence, method, *lookup.MAIN)
        known = np.array(method.facts.weights or [math.nan] * 4)
        same = trials[np.isclose(trials[list(WEIGHTS)].to_numpy(float), known, rtol=0, atol=SAME).all(1)]
        if rows is not None and len(same):
            trial = same.iloc[0]
            simple, sr = _trial_rate(trial), stats.rate_of(rows, "sr")
            lost = difference(simple, sr)
            text = f"SR of trial {trial['trial']}'s weights: {_told(simple)} in stage 1, {_told(sr)} in the mixed scene"
            return [Measured(text, lost.low, lost.high, sr.seeds, method.facts.algo)]
    raise NotMeasured("the full method trained with weights of stage 1")


def _trial_rate(trial: pd.Series) -> Rate:
    """A trial's SR: on fresh episodes where it was flown on some (the winner), since nobody chose it by those."""
    fresh = pd.notna(trial.get("sr_fresh_k"))
    k, n = (int(trial[name]) for name in (("sr_fresh_k", "sr_fresh_n") if fresh else ("sr_k", "sr_n")))
    return Rate(k, n, 1, *stats.wilson(k, n))


def real_flights(scenario: str, quantity: str) -> Measure:
    """Of the policy trained for real flights: by how much what ten flights could show exceeds the paper's count
    (``successes``), or in what share the action objective holds (``smooth``)."""

    def measure(evidence: Evidence) -> list[Measured]:
        policies = [method for method in evidence.methods.values() if method.policy and method.for_flight]
        flown = lookup.deployed(evidence, scenario, policies)
        paper = published.published("ours", scenario)
        if flown is None or paper is None:
            raise NotMeasured(f"flights of a policy trained for them, {published.REAL_SCENES[scenario].lower()}")
        method, rows = flown
        seeds = rows["train_seed"].nunique()
        if quantity == "smooth":
            smooth = stats.rate_of(rows, "ok_action")
            text = f"{evidence.names[method.key]}: smooth in {smooth.k}/{smooth.n}"
            return [Measured(text, smooth.low, smooth.high, seeds, method.facts.algo)]
        ten = deployment.summary(rows)
        text = f"{evidence.names[method.key]}: {ten.least} to {ten.most} of ten, the paper {paper.successes}"
        low, high = ten.least - paper.successes, ten.most - paper.successes
        return [Measured(text, low, high, seeds, method.facts.algo)]

    return measure
