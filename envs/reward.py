"""Reward vectors (E, N, 4) in the order formation, flight, obstacle, action (paper, Sec. V-A).

A reward is a list of weighted terms per objective (``conf/reward/``, ``envs.terms``), each objective divided by a
constant of its own: weights on a simplex mean something only where the objectives' spreads are alike, which the paper
asks of its coefficients too. Scalarising is the learner's.
"""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from envs import memory
from envs.step_view import StepView
from envs.terms import TERMS
from envs.vocabulary import OBJECTIVES

Parameters = float | dict[str, float]
"""The coefficient of a term, alone or as ``weight`` beside the term's parameters."""


class Reward(Protocol):
    """A reward vector as a function of one step."""

    def __call__(self, view: StepView) -> Tensor:
        """(E, N, 4)."""
        ...


@dataclass(frozen=True)
class TermReward:
    """Named terms, summed per objective and scaled (``conf/reward/``)."""

    target: str
    name: str
    scale: dict[str, float]  # spread of each objective along the reference flights; its sum of terms is divided by it
    formation: dict[str, Parameters]  # term: coefficient, or {weight: coefficient, parameter: value}
    flight: dict[str, Parameters]
    obstacle: dict[str, Parameters]
    action: dict[str, Parameters]

    def __post_init__(self) -> None:
        if set(self.scale) != set(OBJECTIVES) or min(self.scale.values()) <= 0:
            raise ValueError(f"reward.scale needs a number above 0 for each of {', '.join(OBJECTIVES)}")
        for objective in OBJECTIVES:
            for term, parameters in getattr(self, objective).items():
                _check(f"reward.{objective}.{term}", term, parameters)

    def __call__(self, view: StepView) -> Tensor:
        """(E, N, 4) of one step."""
        objectives = []
        for name in OBJECTIVES:
            total = view.slots.new_zeros(len(view.slots))
            for term, parameters in getattr(self, name).items():
                weight, keywords = _split(parameters)
                if weight:
                    total = total + weight * TERMS[term](view, **keywords)
            objectives.append((total / self.scale[name]).expand_as(view.events.column))
        return memory.stack(tuple(objectives))


def _split(parameters: Parameters) -> tuple[float, Mapping[str, float]]:
    if not isinstance(parameters, dict):
        return parameters, {}
    return parameters["weight"], {key: value for key, value in parameters.items() if key != "weight"}


def _check(key: str, term: str, parameters: Parameters) -> None:
    """Raise ValueError for a term that does not exist, and for parameters that are not the term's."""
    if term not in TERMS:
        raise ValueError(f"{key}: there is no such term; envs/terms.py has {', '.join(TERMS)}")
    given = {"weight"} | (set(parameters) if isinstance(parameters, dict) else set())
    wanted = {"weight"} | set(list(inspect.signature(TERMS[term]).parameters)[1:])
    if isinstance(parameters, dict) and "weight" not in parameters:
        raise ValueError(f"{key}.weight is missing: set it with {key}.weight=VALUE")
    if missing := sorted(wanted - given):
        raise ValueError(f"{key}.{missing[0]} is missing: write {key}={{weight: 1, {missing[0]}: VALUE}}")
    if unknown := sorted(given - wanted):
        raise ValueError(f"unknown key {key}.{unknown[0]}: {term} takes {', '.join(sorted(wanted))}")
