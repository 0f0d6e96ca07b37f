"""Which method, and its episodes in one place: what tables, figures and claims ask the evidence for."""

from collections.abc import Iterable
from typing import NamedTuple, TypeAlias

import pandas as pd

from analysis.data import methods
from analysis.data.evidence import Evidence, Where, World
from analysis.data.methods import Method
from analysis.data.published import SWEEPS, Axis
from analysis.data.runs import Run

MAIN = ("mixed", 10, 2)
"""The paper's main scene: scenario, columns, balls (Table I)."""

Flown: TypeAlias = tuple[Method, pd.DataFrame]
"""A method and its episodes in one place."""


class Sets(NamedTuple):
    """Two parameter sets of one planner: that of its published code, and one that fits this task."""

    published: Method
    fair: Method


def main_place(evidence: Evidence) -> Where | None:
    """The main scene in the paper's world; the next best world where that was never flown; None if neither."""
    return next(iter(evidence.places(*MAIN)), None)


def full(evidence: Evidence) -> list[Method]:
    """The paper's full method, as every learner and budget trained it."""
    return [method for method in evidence.methods.values() if method.role == "ours"]


def ours(evidence: Evidence) -> tuple[Method | None, pd.DataFrame | None]:
    """Our best policy in the main scene and its episodes there: the paper's full method, or a recipe of our own."""
    for where in evidence.places(*MAIN):
        if where.world.standard and (method := best(evidence, where)) is not None:
            return method, evidence.rows(method, where)
    return next(iter(_candidates(evidence)), None), None


def best(evidence: Evidence, where: Where) -> Method | None:
    """The full method with the highest CFR in a place; where none flew there, the other policy of the mixed scene."""
    flown = [(m, rows) for m in _candidates(evidence) if (rows := evidence.rows(m, where)) is not None]
    first = [(m, rows) for m, rows in flown if m.role == "ours"] or flown
    return max(first, key=lambda pair: float(pair[1]["cfr"].mean()))[0] if first else None


def _candidates(evidence: Evidence) -> list[Method]:
    """Policies trained for the mixed scene, the paper's full method first."""
    known = [m for m in evidence.shown if m.policy and m.scene == "mixed" and m.role == "other" and not m.paper_name]
    return full(evidence) + known


def named(evidence: Evidence, name: str) -> Method | None:
    """The baseline that the paper calls so; None where the store has none."""
    return next((m for m in evidence.methods.values() if m.paper_name == name and m.facts.name == name), None)


def episodes(evidence: Evidence, method: Method | None, scenario: str, columns: int, balls: int) -> pd.DataFrame | None:
    """A method's episodes in the paper's world; None where it was not flown there."""
    if method is None:
        return None
    places = [where for where in evidence.places(scenario, columns, balls) if where.world.standard]
    return next((rows for where in places if (rows := evidence.rows(method, where)) is not None), None)


def swept(evidence: Evidence, method: Method | None, axis: Axis, count: int) -> pd.DataFrame | None:
    """A method's episodes at one point of a sweep."""
    counts = {"columns": 0, "balls": 0} | {axis: count}
    return episodes(evidence, method, SWEEPS[axis][0], **counts)


def sweep_cells(evidence: Evidence, axis: Axis, least: int) -> list[tuple[Method, Where]]:
    """Cells of at least so many episodes that are points of a sweep, by method, with a rising number of obstacles."""
    none = {"balls": 0} if axis == "columns" else {"columns": 0}
    places = sorted(evidence.places(SWEEPS[axis][0], **none), key=lambda place: getattr(place, axis))
    return [
        (method, where)
        for method in evidence.shown
        for where in places
        if (rows := evidence.rows(method, where)) is not None and len(rows) >= least
    ]


def sweep_worlds(evidence: Evidence, axis: Axis, least: int) -> list[World]:
    """Worlds in which a sweep was flown, the paper's first."""
    worlds = {where.world for _, where in sweep_cells(evidence, axis, least)}
    return sorted(worlds, key=lambda world: (world.rank(), world.settings))


def arms(evidence: Evidence, encoder: str, curriculum: str) -> list[Method]:
    """An arm of the ablations: where there is a full method, only what was trained as one of those was otherwise."""
    whole = [m for m in evidence.methods.values() if m.recipe and m.role in ("ours", "other")]
    whole = [m for m in whole if m.role == "ours"] or whole
    return [
        method
        for method in evidence.methods.values()
        if (method.role == "arm" or method in whole)
        and (method.facts.encoder, method.facts.curriculum) == (encoder, curriculum)
        and (not whole or any(methods.alike(method, other) for other in whole))
    ]


def arm(evidence: Evidence, encoder: str, curriculum: str) -> Flown | None:
    """The arm that differs from our best full method in nothing else, budget included, and its main scene."""
    whole, _ = ours(evidence)
    for method in arms(evidence, encoder, curriculum):
        if whole is not None and methods.alike(method, whole) and method.facts.steps == whole.facts.steps:
            rows = episodes(evidence, method, *MAIN)
            if rows is not None:
                return method, rows
    return None


def deployed(evidence: Evidence, scenario: str, policies: Iterable[Method]) -> Flown | None:
    """Disturbed flights of the first of some policies that has any: in MuJoCo, over motion capture, where flown so."""
    places = [where for where in evidence.places(scenario) if where.world.deploy and " " not in where.world.deploy]
    places.sort(key=lambda where: (where.world.sim != "mujoco", where.world.deploy != "mocap"))
    flights = ((method, evidence.rows(method, where)) for method in policies for where in places)
    return next(((method, rows) for method, rows in flights if rows is not None), None)


def parameter_sets(known: Iterable[Method]) -> list[Sets]:
    """Planners of which both sets are there: agents of one class, with the roles ``published`` and ``fair``."""
    baselines = [method for method in known if not method.policy]
    return [
        Sets(one, other)
        for one in baselines
        for other in baselines
        if (one.role, other.role) == ("published", "fair")
        and one.setting("baseline.target") == other.setting("baseline.target")
    ]


def study(evidence: Evidence) -> tuple[Run, pd.DataFrame] | None:
    """The profile's latest study with a finished trial, and its finished trials (SR known), the best first."""
    store = evidence.store
    for run in reversed(store.runs):
        if run.kind != "search" or run.profile != evidence.profile or run.id not in store.studies:
            continue
        table = store.studies[run.id]
        done = table[table["sr"].notna() & (table["state"].astype(str) == "done")]
        if len(done):
            return run, done.sort_values(["sr", "trial"], ascending=[False, True]).reset_index(drop=True)
    return None
