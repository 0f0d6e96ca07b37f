"""One method's episodes in one place: what the judges of the claims ask for."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, TypeAlias

from analysis import methods, series, stats
from analysis.evidence import Evidence, Where
from analysis.methods import Method
from analysis.tables import is_headline

if TYPE_CHECKING:
    import pandas as pd

Flown: TypeAlias = "tuple[Method, pd.DataFrame]"
"""A method and its episodes in one place."""


def ours(evidence: Evidence) -> "tuple[Method | None, pd.DataFrame | None]":
    """Our best policy in the main scene and its episodes there: the paper's full method, or a recipe of our own."""
    for where in evidence.places("mixed", 10, 2):
        if is_headline(where.world) and (found := best(evidence, where)) is not None:
            return found, evidence.rows(found, where)
    return next(iter(_known(evidence)), None), None


def best(evidence: Evidence, where: Where) -> Method | None:
    """The full method with the highest CFR in a place; where none flew there, the other policy of the mixed scene."""
    flown = [(m, rows) for m in _known(evidence) if (rows := evidence.rows(m, where)) is not None]
    full = [(m, rows) for m, rows in flown if m.role == "ours"]
    return max(full or flown, key=lambda pair: float(pair[1]["cfr"].mean()))[0] if flown else None


def _known(evidence: Evidence) -> list[Method]:
    """Policies trained for the mixed scene, the paper's full method first."""
    known = [m for m in evidence.shown if m.facts.kind == "policy" and m.scene == "mixed" and not m.paper_name]
    return full(evidence) + [m for m in known if m.role != "ours"]


def full(evidence: Evidence) -> list[Method]:
    """The paper's full method, as every learner and budget trained it."""
    return [method for method in evidence.methods.values() if method.role == "ours"]


def named(evidence: Evidence, name: str) -> Method | None:
    """The method that the paper calls so; None where the store has none."""
    return next((method for method in evidence.methods.values() if method.paper_name == name), None)


def episodes(
    evidence: Evidence, method: Method | None, scenario: str, columns: int, balls: int
) -> "pd.DataFrame | None":
    """A method's episodes in the paper's world; None where it was not flown there."""
    for where in evidence.places(scenario, columns, balls):
        world = where.world._replace(ball_aim=where.world.ball_aim or "drone")
        if method is not None and is_headline(world) and (rows := evidence.rows(method, where)) is not None:
            return rows
    return None


def swept(evidence: Evidence, method: Method | None, axis: series.Axis, count: int) -> "pd.DataFrame | None":
    """A method's episodes at one point of a sweep."""
    scenario, none = series.SWEEPS[axis]
    return episodes(evidence, method, scenario, **({axis: count} | none))


def arms(evidence: Evidence, encoder: str, curriculum: str) -> list[Method]:
    """An arm of the ablations: where there is a full method, only what was trained as one of those was otherwise."""
    known = full(evidence)
    return [
        method
        for method in evidence.methods.values()
        if method.role in ("ours", "arm")
        and (method.facts.encoder, method.facts.curriculum) == (encoder, curriculum)
        and (not known or any(methods.alike(method, other) for other in known))
    ]


def arm(evidence: Evidence, encoder: str, curriculum: str) -> "Flown | None":
    """The arm that differs from our best full method in nothing else, budget included, and its main scene."""
    best, _ = ours(evidence)
    for method in arms(evidence, encoder, curriculum):
        if best is not None and methods.alike(method, best) and method.facts.steps == best.facts.steps:
            rows = episodes(evidence, method, "mixed", 10, 2)
            if rows is not None:
                return method, rows
    return None


def deployed(evidence: Evidence, scenario: str, policies: Iterable[Method]) -> "Flown | None":
    """Disturbed flights of the first of some policies that has any: in MuJoCo, over motion capture, where flown so."""
    places = [where for where in evidence.places(scenario) if where.world.deploy and " " not in where.world.deploy]
    places.sort(key=lambda where: (where.world.sim != "mujoco", where.world.deploy != "mocap"))
    flights = ((method, evidence.rows(method, where)) for method in policies for where in places)
    return next(((method, rows) for method, rows in flights if rows is not None), None)


def paired(first: "pd.DataFrame", second: "pd.DataFrame", columns: Iterable[str]) -> "pd.DataFrame":
    """Episodes of one draw that both methods flew, one row each: the ``columns`` of the first end in _a, others in _b.

    n-th seed against n-th, seeds beyond left out; a single seed against all of the other's. ``pair`` numbers them.
    """
    import pandas as pd

    keys = ["draw", "scenario_id"]
    seeds = [sorted(rows["train_seed"].unique()) for rows in (first, second)]
    count = max(map(len, seeds)) if min(map(len, seeds)) == 1 else min(map(len, seeds))
    parts = []
    for n in range(count):
        a, b = (
            rows.loc[rows["train_seed"] == own[n % len(own)], [*keys, "train_seed", *columns]].astype({"draw": str})
            for rows, own in zip((first, second), seeds, strict=True)
        )
        parts.append(a.merge(b, on=keys, suffixes=("_a", "_b")).assign(pair=n))
    stacked: pd.DataFrame = pd.concat(parts, ignore_index=True)
    return stacked


def rate(rows: "pd.DataFrame", column: str = "cfr") -> stats.Rate:
    """Share of episodes whose flag ``column`` is set."""
    return stats.rate(rows[column].to_numpy(bool), rows["train_seed"].to_numpy())


def fm(rows: "pd.DataFrame") -> stats.Mean | None:
    """FM (m) over the successful episodes; None without any."""
    ok = rows["cfr"].to_numpy(bool)
    return stats.mean(rows["fm"].to_numpy(float)[ok], rows["train_seed"].to_numpy()[ok])
