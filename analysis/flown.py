"""One method's episodes in one place: what the judges of the claims ask for."""

from typing import TYPE_CHECKING

from analysis import methods, series, stats
from analysis.evidence import Evidence, Where
from analysis.methods import Method
from analysis.tables import is_headline

if TYPE_CHECKING:
    import pandas as pd


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
    return [m for m in evidence.methods.values() if m.role == "ours"] + [m for m in known if m.role != "ours"]


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
    full = [method for method in evidence.methods.values() if method.role == "ours"]
    return [
        method
        for method in evidence.methods.values()
        if method.role in ("ours", "arm")
        and (method.facts.encoder, method.facts.curriculum) == (encoder, curriculum)
        and (not full or any(methods.alike(method, other) for other in full))
    ]


def arm(evidence: Evidence, encoder: str, curriculum: str) -> "pd.DataFrame | None":
    """Episodes in the main scene of the arm that differs from our best full method in nothing else, budget included."""
    full, _ = ours(evidence)
    for method in arms(evidence, encoder, curriculum):
        if full is not None and methods.alike(method, full) and method.facts.steps == full.facts.steps:
            rows = episodes(evidence, method, "mixed", 10, 2)
            if rows is not None:
                return rows
    return None


def deployed(evidence: Evidence, scenario: str) -> "tuple[Method, pd.DataFrame] | None":
    """Disturbed flights of the policy that was trained for real flights, as the paper's was, or else of another."""
    places: list[Where] = [w for w in evidence.places(scenario) if w.world.deploy and " " not in w.world.deploy]
    policies = [method for method in evidence.methods.values() if method.role in ("ours", "other")]
    policies.sort(key=lambda method: method.facts.experiment != methods.FOR_FLIGHT)
    flights = ((method, evidence.rows(method, where)) for method in policies for where in places)
    return next(((method, rows) for method, rows in flights if rows is not None), None)


def rate(rows: "pd.DataFrame", column: str = "cfr") -> stats.Rate:
    """Share of episodes whose flag ``column`` is set."""
    return stats.rate(rows[column].to_numpy(bool), rows["train_seed"].to_numpy())


def fm(rows: "pd.DataFrame") -> stats.Mean | None:
    """FM (m) over the successful episodes; None without any."""
    ok = rows["cfr"].to_numpy(bool)
    return stats.mean(rows["fm"].to_numpy(float)[ok], rows["train_seed"].to_numpy()[ok])
