"""What the baselines of a report are: parameter sets side by side, and where they depart from what was published."""

from collections.abc import Iterator

from analysis.data.evidence import Evidence
from analysis.data.lookup import Sets, parameter_sets
from analysis.data.methods import Method
from analysis.tables.table import NOTHING, Cell, Column, Table


def tables(evidence: Evidence) -> Iterator[Table]:
    """The sets of every planner that flew with both, then the deviations of all that flew; nothing without any."""
    flown = [method for method in evidence.methods.values() if not method.policy]
    for sets in parameter_sets(flown):
        yield _sets(evidence, sets)
    if any(_deviations(evidence, method) for method in flown):
        yield _departures(evidence, flown)


def _sets(evidence: Evidence, sets: Sets) -> Table:
    """Settings in which two sets differ."""
    left, right = (method.values for method in sets)
    rows = tuple(
        (Cell(key.removeprefix("baseline.")), Cell(left.get(key, NOTHING)), Cell(right.get(key, NOTHING)))
        for key in sorted(left.keys() | right.keys())
        if left.get(key) != right.get(key) and key != "baseline.name"
    )
    names = [evidence.names[method.key] for method in sets]
    columns = tuple(Column(key, name, left=True) for key, name in zip(("public", "fair"), names, strict=True))
    title = f"Parameter sets of {names[0]}"
    caption = "Settings in which they differ; the units stand in conf/baseline, all settings under Provenance."
    key, stamp = f"sets_{sets.published.facts.name}", evidence.stamp(_cells(evidence, list(sets)))
    return Table(key, title, caption, (Column("setting", "Setting", left=True), *columns), rows, stamp)


def _departures(evidence: Evidence, flown: list[Method]) -> Table:
    """Every deviation once, with the sets it holds for; a group begins where the sets change."""
    holds: dict[str, list[str]] = {}
    for method in flown:
        for text in _deviations(evidence, method):
            holds.setdefault(text, []).append(evidence.names[method.key])
    named = [("; ".join(names), text) for text, names in holds.items()]
    starts = {names: number for number, (names, _) in reversed(list(enumerate(named)))}
    rows = tuple(
        (Cell(names if starts[names] == number else ""), Cell(text)) for number, (names, text) in enumerate(named)
    )
    columns = (
        Column("method", "Method", left=True, wide=0.18),
        Column("deviation", "Departs from what was published", left=True, wide=0.74),
    )
    stamp = evidence.stamp(_cells(evidence, flown))
    return Table("deviations", "Deviations of the baselines", "As recorded with the flights.", columns, rows, stamp)


def _deviations(evidence: Evidence, method: Method) -> tuple[str, ...]:
    """Of the method's latest evaluation."""
    facts = [run.method for run in reversed(evidence.runs) if run.method and run.method.name == method.facts.name]
    return next((known.deviations for known in facts if known.deviations), ())


def _cells(evidence: Evidence, flown: list[Method]) -> list:
    keys = {method.key for method in flown}
    return [place for place in evidence.cells if place[0] in keys]
