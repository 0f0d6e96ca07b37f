"""One method's episodes in one place: what the judges of the claims ask for."""

from typing import TYPE_CHECKING

from analysis import series, stats
from analysis.evidence import Evidence, Where
from analysis.methods import Method
from analysis.tables import is_headline

if TYPE_CHECKING:
    import pandas as pd


def ours(evidence: Evidence) -> "tuple[Method | None, pd.DataFrame | None]":
    """The full method with the highest CFR in the main scene, and its episodes there."""
    known = [method for method in evidence.methods.values() if method.role == "ours"]
    flown = [(m, rows) for m in known if (rows := episodes(evidence, m, "mixed", 10, 2)) is not None]
    if flown:
        return max(flown, key=lambda pair: float(pair[1]["cfr"].mean()))
    return (known[0] if known else None), None


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


def arm(evidence: Evidence, encoder: str, curriculum: str) -> "pd.DataFrame | None":
    """Episodes of an arm of the ablations in the main scene."""
    for method in evidence.methods.values():
        facts = method.facts
        if facts.kind == "policy" and (facts.encoder, facts.curriculum) == (encoder, curriculum):
            rows = episodes(evidence, method, "mixed", 10, 2)
            if rows is not None:
                return rows
    return None


def deployed(evidence: Evidence, scenario: str) -> "list[pd.DataFrame | None]":
    """Disturbed flights of the full method or, since it is a training of its own, of the one for real flights."""
    places: list[Where] = [w for w in evidence.places(scenario) if w.world.deploy and " " not in w.world.deploy]
    policies = [method for method in evidence.methods.values() if method.role in ("ours", "other")]
    return [evidence.rows(method, where) for method in policies for where in places]


def rate(rows: "pd.DataFrame", column: str = "cfr") -> stats.Rate:
    """Share of episodes whose flag ``column`` is set."""
    return stats.rate(rows[column].to_numpy(bool), rows["train_seed"].to_numpy())


def fm(rows: "pd.DataFrame") -> stats.Mean | None:
    """FM (m) over the successful episodes; None without any."""
    ok = rows["cfr"].to_numpy(bool)
    return stats.mean(rows["fm"].to_numpy(float)[ok], rows["train_seed"].to_numpy()[ok])
