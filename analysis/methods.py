"""Who was measured: which rows belong to one method, what it is called, and where it stands in the paper.

Rows are pooled over training seeds and over nothing else. Two policies are one method only when algorithm, encoder,
curriculum, weights, training steps *and* every other setting they were trained with agree (``config.yaml``).
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from analysis.records import MethodFacts, Run

LABELS = {
    "swarm_rl": "Swarm-RL",
    "rmader": "R-MADER",
    "swarm_formation": "Swarm-Formation",
    "rmader_fair": "R-MADER, fair",
    "swarm_formation_fair": "Swarm-Formation, fair",
    "rmader_real": "R-MADER, for real flights",
    "swarm_formation_real": "Swarm-Formation, for real flights",
    "straight_line": "Straight line",
    "hover": "Hover",
}
LEARNERS = ("shac", "mappo")
"""In the order of tables, the default learner first; any other follows."""
RECIPES = {
    "shac_dense": "dense scenes",
    "mappo_mixed": "mixed scene throughout",
    "sim_to_real": "for real flights",
    "swarm_rl": "Swarm-RL",
}
"""Trainings of this project that are not the paper's (``conf/experiment``), and what tells them apart."""

FOR_FLIGHT = "sim_to_real"
"""The one of them that trains for real flights."""
FLIGHT_SET = "_real"
"""How the names of planners with parameters for real flights end."""

SANITY = ("straight_line", "hover")
"""Agents that avoid nothing: the floor under every rate."""

ENCODERS = {"attention": "Ours", "no_ca": "w/o CA", "no_sa": "w/o SA", "mlp": "MLP"}
"""Arms of the encoder ablation (paper, Sec. VI-C1) and their names there."""

CURRICULA = {
    "three_period": "Ours",
    "three_period_dynamic": "3-period, dynamic",
    "two_period": "2-period",
    "none": "w/o CL",
}
"""Arms of the curriculum ablation (paper, Sec. VI-C2) and their names there."""

PAPER_SCENE = {"scenario.columns": "10", "scenario.balls": "2"}
"""What the paper trains in last; arms of an ablation share it."""

TRAINED_WITH = (
    "scenario",
    "drone",
    "observation",
    "reward",
    "weights",
    "encoder",
    "algo",
    "curriculum",
    "train",
    "sim",
)
"""Groups of ``config.yaml`` that make a policy what it is."""

_NOT_A_SETTING = ("train.compile", "train.checkpoint_minutes", "train.log_updates")
"""Keys of those groups that decide how a training runs, not what comes out."""

_LATER = {"drone.latency": "0.0"}
"""Keys that older runs do not have, and the value that they stand for there."""


@dataclass(frozen=True)
class Method:
    """One line of a table: a baseline, or all seeds of one way of training. ``key`` is equal for rows that pool."""

    key: str
    facts: MethodFacts
    settings: tuple[tuple[str, str], ...]  # every setting, flattened; () when the training run is not in the store

    @property
    def scene(self) -> str:
        """Scenario that a method is meant for; the paper's mixed scene where its settings do not tell."""
        if self.facts.kind != "policy" and self.facts.name.endswith(FLIGHT_SET):
            return "real_mixed"
        return dict(self.settings).get("scenario.name", '"mixed"').strip('"')

    @property
    def role(self) -> str:
        """``ours`` (the paper's full method), ``arm`` of an ablation, ``baseline``, ``sanity`` or ``other`` policy.

        A training with a recipe or a scene of its own is no arm: more than one thing sets it apart.
        """
        if self.facts.kind != "policy":
            return "sanity" if self.facts.name in SANITY else "baseline"
        if self.scene != "mixed":
            return "other"
        encoder, curriculum = self.facts.encoder, self.facts.curriculum
        if encoder == "attention" and curriculum == "three_period":
            return "ours"
        own = dict(self.settings)
        if self.facts.experiment or any(own.get(key, value) != value for key, value in PAPER_SCENE.items()):
            return "other"
        known = (encoder in ENCODERS and curriculum == "three_period") or (
            encoder == "attention" and curriculum in CURRICULA
        )
        return "arm" if known else "other"

    @property
    def paper_name(self) -> str:
        """Name in ``analysis.paper``; empty when the paper has no such method."""
        if self.role == "ours":
            return "ours"
        return self.facts.name if self.role in ("baseline", "other") and self.facts.name in LABELS else ""


def identify(facts: MethodFacts, evaluation: Run, training: Run | None) -> Method:
    """The method that an evaluation flew; ``training`` is the run its policy comes from, None when not in the store."""
    if facts.kind == "policy":
        settings = flatten(training.config, TRAINED_WITH) if training else {}
        # Without the training's settings nothing proves that two policies are alike: the name keeps them apart.
        known = (facts.algo, facts.encoder, facts.curriculum, facts.weights, facts.steps)
        identity: tuple[Any, ...] = (*known, sorted(settings.items()) if settings else facts.name)
    else:
        settings = flatten(evaluation.config, ("baseline",), without=("baseline.deviations",))  # words, not a setting
        identity = (facts.name, sorted(settings.items()))
    digest = hashlib.sha256(json.dumps([facts.kind, identity]).encode()).hexdigest()[:12]
    return Method(
        f"{facts.name}-{digest}" if facts.kind != "policy" else digest, facts, tuple(sorted(settings.items()))
    )


def alike(one: Method, other: Method) -> bool:
    """Whether two policies were trained the same way but for encoder, curriculum and budget: arms of one ablation."""
    if one.facts.algo != other.facts.algo or not one.settings or not other.settings:
        return one.facts.algo == other.facts.algo
    free = ("encoder.", "curriculum.", "train.")
    mine, theirs = ({pair for pair in m.settings if not pair[0].startswith(free)} for m in (one, other))
    return mine == theirs


def flatten(tree: Mapping[str, Any], groups: Iterable[str], without: Iterable[str] = ()) -> dict[str, str]:
    """Some groups of a settings tree as ``{"group.key": value text}``, without the keys named, and without later ones
    at the value that they stood for before there were any."""
    dropped = {*without, *_NOT_A_SETTING}
    flat: dict[str, str] = {}

    def walk(prefix: str, value: object) -> None:
        if prefix in dropped:
            return
        if isinstance(value, Mapping):
            for key, inner in value.items():
                walk(f"{prefix}.{key}", inner)
        else:
            text = json.dumps(value, sort_keys=True, default=str)
            if _LATER.get(prefix) != text:
                flat[prefix] = text

    for group in groups:
        if group in tree:
            walk(group, tree[group])
    return flat


def order(method: Method) -> tuple[int, int, str, str]:
    """Sorting key of tables and legends: ours, other policies, the paper's baselines, sanity agents, ablation arms."""
    algo = method.facts.algo
    rank = {"ours": 0, "other": 1, "baseline": 2, "sanity": 20, "arm": 30}[method.role]
    if method.role == "arm":
        rank += list(ENCODERS).index(method.facts.encoder) + 10 * list(CURRICULA).index(method.facts.curriculum)
    elif method.facts.name in LABELS and method.facts.kind != "policy":
        rank += list(LABELS).index(method.facts.name)
    return rank, LEARNERS.index(algo) if algo in LEARNERS else len(LEARNERS), algo, method.key


def labels(methods: Iterable[Method]) -> dict[str, str]:
    """A short name for every method, unique among those given: equal names get the settings in which they differ."""
    family: dict[str, list[Method]] = {}
    for method in sorted(methods, key=order):
        family.setdefault(_plain(method), []).append(method)
    names: dict[str, str] = {}
    for plain, members in family.items():
        for method in members:
            extra = _difference(method, members) if len(members) > 1 else ""
            names[method.key] = f"{plain} ({extra})" if extra else plain
        if len({names[method.key] for method in members}) < len(members):  # alike to the eye: number them
            for number, method in enumerate(members, start=1):
                names[method.key] += f" #{number}"
    return names


def short(count: int | None) -> str:
    """Training steps as text: 6.0 M, 250 k; an en dash for None."""
    if count is None:
        return "–"
    for unit, name in ((1_000_000_000, "G"), (1_000_000, "M"), (1_000, "k")):
        if count >= unit:
            return f"{count / unit:.3g} {name}"
    return str(count)


def _plain(method: Method) -> str:
    facts = method.facts
    if facts.kind != "policy":
        return LABELS.get(facts.name, facts.name)
    algo = facts.algo.upper() or facts.name
    if method.role == "ours":
        return f"Ours, {algo}"
    if method.role == "arm":
        arm = CURRICULA[facts.curriculum] if facts.encoder == "attention" else ENCODERS[facts.encoder]
        box = ", balls at the box" if dict(method.settings).get("scenario.ball_aim") == '"box"' else ""
        return f"{algo}, {arm}{box}"
    if facts.experiment:
        return f"{algo}, {RECIPES.get(facts.experiment, facts.experiment)}"
    parts = []
    if facts.encoder != "attention":
        parts.append(f"encoder {facts.encoder}" if facts.encoder else "")
    if facts.curriculum != "three_period":
        parts.append(f"curriculum {facts.curriculum}" if facts.curriculum else "")
    if method.scene != "mixed":
        parts.append(f"trained on {method.scene}")
    own = dict(method.settings)
    if method.scene == "mixed" and any(own.get(key, value) != value for key, value in PAPER_SCENE.items()):
        parts.append(f"trained with {own['scenario.columns']} columns, {own['scenario.balls']} balls")
    return ", ".join([algo, *filter(None, parts)])


def _difference(method: Method, members: list[Method]) -> str:
    """What sets a method apart from others of the same plain name, in at most three short pieces."""
    pieces = []
    if len({m.facts.steps for m in members}) > 1:
        pieces.append(f"{short(method.facts.steps)} steps")
    if len({m.facts.weights for m in members}) > 1:
        pieces.append("w = " + "/".join(f"{weight:.2f}" for weight in method.facts.weights))
    own = dict(method.settings)
    others = [dict(m.settings) for m in members]
    skip = ("train.steps", "weights", "encoder.", "curriculum.", "algo.name")
    for key in sorted(set().union(*others)):
        if not key.startswith(skip) and len({other.get(key) for other in others}) > 1:
            group, _, last = key.rpartition(".")
            pieces.append(f"{group if last == 'name' else last} {own.get(key, 'unknown').strip(chr(34))}")
    if not pieces and len({m.facts.name for m in members}) > 1:
        pieces.append(method.facts.name)
    return ", ".join(pieces[:3])
