"""What the baselines of a report are: parameter sets side by side, and where they depart from what was published."""

from typing import TYPE_CHECKING

from analysis.cells import NOTHING, Cell, Column, Table

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from analysis.evidence import Evidence, Stamp
    from analysis.methods import Method

FAIR = "_fair"
"""Ending of the name of a set that fits this task."""


def tables(evidence: "Evidence") -> "Iterator[Table]":
    """The sets of every planner that flew with both, then the deviations of all that flew; nothing without any."""
    flown = [method for method in evidence.methods.values() if method.role == "baseline"]
    for published, fair in pairs(flown):
        yield _sets(evidence, published, fair)
    if any(_deviations(evidence, method) for method in flown):
        yield _departures(evidence, flown)


def pairs(methods: "Iterable[Method]") -> "Iterator[tuple[Method, Method]]":
    """Planners of which both sets are there: with the parameters of its code, and with those that fit this task."""
    by_name = {method.facts.name: method for method in methods if method.role == "baseline"}
    for name, published in by_name.items():
        if (fair := by_name.get(f"{name}{FAIR}")) is not None:
            yield published, fair


def _sets(evidence: "Evidence", published: "Method", fair: "Method") -> Table:
    """Settings in which two sets differ."""
    left, right = dict(published.settings), dict(fair.settings)
    keys = sorted(key for key in left.keys() | right.keys() if left.get(key) != right.get(key))
    rows = tuple(
        (Cell(key.removeprefix("baseline.")), Cell(left.get(key, NOTHING)), Cell(right.get(key, NOTHING)))
        for key in keys
    )
    names = evidence.names[published.key], evidence.names[fair.key]
    columns = (
        Column("setting", "Setting", left=True),
        Column("public", names[0], left=True),
        Column("fair", names[1], left=True),
    )
    title = f"Parameter sets of {names[0]}"
    caption = "Settings in which they differ; the units stand in conf/baseline, all settings under Provenance."
    return Table(f"sets_{published.facts.name}", title, caption, columns, rows, _stamp(evidence, [published, fair]))


def _departures(evidence: "Evidence", flown: "list[Method]") -> Table:
    """Every deviation once, with the sets it holds for."""
    holds: dict[str, list[str]] = {}
    for method in flown:
        for text in _deviations(evidence, method):
            holds.setdefault(text, []).append(evidence.names[method.key])
    first: dict[str, str] = {}
    for text, names in holds.items():
        first.setdefault("; ".join(names), text)
    rows = tuple(
        (Cell("; ".join(names) if first["; ".join(names)] == text else ""), Cell(text)) for text, names in holds.items()
    )
    columns = (
        Column("method", "Method", left=True, wide=0.18),
        Column("deviation", "Departs from what was published", left=True, wide=0.74),
    )
    caption = "As recorded with the flights."
    return Table("deviations", "Deviations of the baselines", caption, columns, rows, _stamp(evidence, flown))


def _deviations(evidence: "Evidence", method: "Method") -> tuple[str, ...]:
    """Of the method's latest evaluation."""
    for run in reversed(evidence.runs):
        facts = run.raw.get("method") or {}
        if facts.get("name") == method.facts.name and facts.get("deviations"):
            return tuple(str(text) for text in facts["deviations"])
    return ()


def _stamp(evidence: "Evidence", flown: "list[Method]") -> "Stamp":
    keys = {method.key for method in flown}
    return evidence.stamp(place for place in evidence.cells if place[0] in keys)
