"""Who was measured: which rows belong to one method, what it is called, and where it stands in the paper.

Rows are pooled over training seeds and over nothing else. Two policies are one method only when algorithm, encoder,
curriculum, weights, training steps *and* every other setting they were trained with agree (``config.yaml``).
A baseline's label and role are keys of its YAML (``conf/baseline``) and come with the record of its flights.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from analysis.data.published import CURRICULA, ENCODERS, METHODS
from analysis.data.runs import MethodFacts, Run
from analysis.data.text import short

PAPER_SCENE = {"scenario.columns": "10", "scenario.balls": "2"}
"""What the paper trains in last; arms of an ablation share it."""

ROLES = ("ours", "other", "published", "fair", "flight", "baseline", "sanity", "arm")
"""In the order of tables: the paper's full method; other policies; baselines with the parameters of their published
code, with a set that fits this task, with one for real flights, and others; agents that avoid nothing (sanity); arms
of an ablation."""

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

SAME = 1e-6
"""Distance below which two weight vectors are the same."""

_NOT_A_SETTING = ("train.compile", "train.checkpoint_minutes", "train.log_updates", "train.processes")
"""Keys of those groups that decide how a training runs, not what comes out."""

_WORDS = ("baseline.label", "baseline.role", "baseline.deviations")
"""Keys of a baseline that are said of it, and no setting."""

_LATER = {"drone.latency": "0.0"}
"""Keys that older runs do not have, and the value that they stand for there."""


@dataclass(frozen=True)
class Method:
    """One line of a table: a baseline, or all seeds of one way of training. ``key`` is equal for rows that pool."""

    key: str
    facts: MethodFacts
    settings: tuple[tuple[str, str], ...]  # every setting as JSON; () when the training run is not in the store
    label: str = ""  # of a baseline, from its YAML
    known_role: str = ""  # likewise
    searched: bool = False  # whether its weights are the winner's of a search

    @cached_property
    def values(self) -> dict[str, str]:
        """``settings`` by key."""
        return dict(self.settings)

    def setting(self, key: str, default: str = "") -> str:
        """A setting as plain text."""
        return self.values.get(key, default).strip('"')

    @property
    def policy(self) -> bool:
        """Whether it is one of this project's policies."""
        return self.facts.kind == "policy"

    @property
    def scene(self) -> str:
        """Scenario that a method is meant for; the paper's mixed scene where its settings do not tell."""
        if self.known_role == "flight":
            return "real_mixed"
        return self.setting("scenario.name", "mixed")

    @property
    def for_flight(self) -> bool:
        """Whether it is meant for the scenes of the real flights."""
        return self.scene.startswith("real")

    @property
    def recipe(self) -> bool:
        """Whether encoder and curriculum are the paper's."""
        return (self.facts.encoder, self.facts.curriculum) == ("attention", "three_period")

    @property
    def weights_name(self) -> str:
        """Where its weights come from, in words: a name of ``conf/weights``, or a trial of a study."""
        name = self.setting("weights.name")
        if not name.startswith("@"):
            return name
        *study, which = name.removeprefix("@").split("/")
        if "search" in study:  # the path of a run folder: search/NAME/ID
            study = study[study.index("search") + 1 :]
        return f"{which.replace('=', ' ')} of {study[0] if study else 'a search'}"

    @cached_property
    def role(self) -> str:
        """One of ``ROLES``. Ours: weights of a search, three periods, attention, the mixed scene.

        An arm lacks one part of encoder or curriculum and shares everything else with some other policy (``alike``).
        """
        if not self.policy:
            return self.known_role if self.known_role in ROLES else "baseline"
        if self.scene != "mixed" or any(self.values.get(key, value) != value for key, value in PAPER_SCENE.items()):
            return "other"
        if self.recipe:
            return "ours" if self.searched else "other"
        encoder, curriculum = self.facts.encoder, self.facts.curriculum
        known = (encoder in ENCODERS and curriculum == "three_period") or (
            encoder == "attention" and curriculum in CURRICULA
        )
        return "arm" if known and not self.facts.experiment else "other"

    @property
    def paper_name(self) -> str:
        """What the paper's tables call it, of ``METHODS``; empty when the paper has no such method."""
        if self.role == "ours" or (self.policy and self.for_flight):
            return "ours"
        return self.facts.name if self.facts.name in METHODS and self.role in ("published", "other") else ""

    @property
    def trained(self) -> tuple[str, ...]:
        """Reward, weights and observation that a policy was trained with, in words, as far as its settings tell."""
        weights = "/".join(f"{weight:.2f}" for weight in self.facts.weights)
        parts = (
            ("reward", self.setting("reward.name")),
            ("weights", f"{self.weights_name} {weights}".strip()),
            ("observation", self.setting("observation.name")),
        )
        return tuple(f"{name} {value}" for name, value in parts if value and self.policy)


def identify(
    facts: MethodFacts, evaluation: Run, training: Run | None, winners: Sequence[tuple[float, ...]] = ()
) -> Method:
    """The method that an evaluation flew; ``training`` is the run its policy comes from, None when not in the store.

    ``winners``: weights that searches have chosen.
    """
    if facts.kind == "policy":
        settings = flatten(training.config, TRAINED_WITH) if training else {}
        # Without the training's settings nothing proves that two policies are alike: the name keeps them apart.
        known = (facts.algo, facts.encoder, facts.curriculum, facts.weights, facts.steps)
        identity: tuple[Any, ...] = (*known, sorted(settings.items()) if settings else facts.name)
    else:
        settings = flatten(evaluation.config, ("baseline",), without=_WORDS)
        identity = (facts.name, sorted(settings.items()))
    digest = hashlib.sha256(json.dumps([facts.kind, identity]).encode()).hexdigest()[:12]
    said = {} if facts.kind == "policy" else evaluation.config.get("baseline") or {}
    key = digest if facts.kind == "policy" else f"{facts.name}-{digest}"
    label, role = (str(said.get(name) or "") for name in ("label", "role"))
    searched = facts.kind == "policy" and (
        str(settings.get("weights.name", "")).strip('"').endswith("/best")
        or any(len(w) == len(facts.weights) and math.dist(w, facts.weights) < SAME for w in winners)
    )
    return Method(key, facts, tuple(sorted(settings.items())), label, role, searched)


def alike(one: Method, other: Method) -> bool:
    """Whether two policies were trained the same way but for encoder, curriculum and budget: arms of one ablation."""
    if one.facts.algo != other.facts.algo or not one.settings or not other.settings:
        return one.facts.algo == other.facts.algo
    return not changed(one, other) - {"encoder", "curriculum", "train"}


def changed(one: Method, other: Method) -> set[str]:
    """Groups of settings in which two policies differ."""
    return {key.partition(".")[0] for key, _ in set(one.settings) ^ set(other.settings)}


def flatten(tree: Mapping[str, Any], groups: Iterable[str], without: Iterable[str] = ()) -> dict[str, str]:
    """Some groups of a settings tree as ``{"group.key": JSON value}``, without the keys named, and without later ones
    at the value that they stood for before there were any."""
    flat: dict[str, str] = {}
    for group in groups:
        if group in tree:
            flat |= leaves({group: tree[group]})
    dropped = {*without, *_NOT_A_SETTING}
    return {key: text for key, text in flat.items() if key not in dropped and _LATER.get(key) != text}


def leaves(tree: Mapping[str, object], prefix: str = "") -> dict[str, str]:
    """A settings tree as ``{"group.key": JSON value}``, in its order; lists are values."""
    flat: dict[str, str] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping) and value:
            flat |= leaves(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = json.dumps(value, ensure_ascii=False, default=str)
    return flat


def order(method: Method) -> tuple[Any, ...]:
    """Sorting key of tables and legends: by role, the paper's methods as it has them, then by name."""
    facts, paper = method.facts, list(METHODS)
    place = paper.index(facts.name) if facts.name in paper else len(paper)
    arms = (
        [*ENCODERS].index(facts.encoder) if facts.encoder in ENCODERS else len(ENCODERS),
        [*CURRICULA].index(facts.curriculum) if facts.curriculum in CURRICULA else len(CURRICULA),
    )
    return ROLES.index(method.role), place, *(arms if method.role == "arm" else ()), facts.algo, facts.name, method.key


def labels(methods: Iterable[Method]) -> dict[str, str]:
    """A short name for every method, unique among those given: equal names get the settings in which they differ."""
    families: dict[str, list[Method]] = {}
    for method in sorted(methods, key=order):
        families.setdefault(plain(method), []).append(method)
    names: dict[str, str] = {}
    for name, members in families.items():
        for method in members:
            extra = _difference(method, members) if len(members) > 1 else ""
            names[method.key] = f"{name} ({extra})" if extra else name
        if len({names[method.key] for method in members}) < len(members):  # alike to the eye: number them
            for number, method in enumerate(members, start=1):
                names[method.key] += f" #{number}"
    return names


def plain(method: Method) -> str:
    """What a method is called: a policy by its learner and what sets it apart from the paper's full method."""
    facts = method.facts
    if not method.policy:
        return method.label or METHODS.get(facts.name, facts.name)
    algo = facts.algo.upper() or facts.name
    if method.role == "ours":
        return f"Ours, {algo}"
    if facts.name in METHODS and facts.experiment == facts.name:
        return f"{algo}, {METHODS[facts.name]}"
    if facts.experiment:
        return f"{algo}, {facts.experiment.replace('_', ' ')}"
    parts = [] if facts.encoder == "attention" else [ENCODERS.get(facts.encoder, facts.encoder)]
    if facts.curriculum == "three_period" and not parts:
        parts.append("three periods")
    elif facts.curriculum != "three_period":
        parts.append(CURRICULA.get(facts.curriculum, facts.curriculum))
    if not method.searched and method.weights_name:
        parts.append(f"weights {method.weights_name}" if method.recipe else "")
    if method.scene != "mixed":
        parts.append(f"trained on {method.scene}")
    elif any(method.values.get(key, value) != value for key, value in PAPER_SCENE.items()):
        columns, balls = (method.setting(key) for key in PAPER_SCENE)
        parts.append(f"trained with {columns} columns, {balls} balls")
    if method.setting("scenario.ball_aim") == "box":
        parts.append("balls at the box")
    return ", ".join([algo, *filter(None, parts)])


def _difference(method: Method, members: list[Method]) -> str:
    """What sets a method apart from others of the same plain name, in at most three short pieces."""
    pieces = []
    if len({m.facts.steps for m in members}) > 1:
        pieces.append(f"{short(method.facts.steps)} steps")
    if len({m.facts.weights for m in members}) > 1:
        pieces.append("w = " + "/".join(f"{weight:.2f}" for weight in method.facts.weights))
    skip = ("train.steps", "weights", "encoder.", "curriculum.", "algo.name")
    for key in sorted(set().union(*(m.values for m in members))):
        if not key.startswith(skip) and len({m.values.get(key) for m in members}) > 1:
            group, _, last = key.rpartition(".")
            pieces.append(f"{group if last == 'name' else last} {method.setting(key, 'unknown')}")
    if not pieces and len({m.facts.name for m in members}) > 1:
        pieces.append(method.facts.name)
    return ", ".join(pieces[:3])
