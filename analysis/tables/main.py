"""The main tables: the paper's Table I beside the same scene here, in its world and in every other one flown."""

from dataclasses import replace

import numpy as np

from analysis import stats
from analysis.data import lookup, published
from analysis.data.evidence import Evidence, Where, world_label, world_words
from analysis.data.lookup import MAIN
from analysis.data.methods import Method
from analysis.tables.notes import notes
from analysis.tables.table import (
    INTERVALS,
    MISSING,
    Cell,
    Column,
    Table,
    evidence_cell,
    flag_cell,
    fm_cell,
    paper_fm,
    paper_rate,
    success_cell,
)

SAME_STEP = 0.02
"""s: MuJoCo at this step takes the same semi-implicit Euler step as our world does, and checks nothing but parity."""

_FM = "FM: episode mean of the unnormalised Laplacian distance, over successful episodes."

_COLUMNS = (
    Column("method", "Method", left=True, wide=0.16),
    Column("cfr", "CFR ↑"),
    Column("cfr_paper", "CFR, paper"),
    Column("fm", "FM (m) ↓"),
    Column("fm_paper", "FM, paper"),
    Column("cfr_strict", "CFR, strict radius"),
    Column("sr", "SR ↑"),
    Column("evidence", "Evidence", left=True),
)


FRONT_COLUMNS = ("method", "cfr", "cfr_paper", "fm", "fm_paper", "cfr_strict", "evidence")
FRONT_ROLES = ("ours", "published", "fair", "sanity")
FRONT_ROWS = 8
"""What of the main table goes on a front page: columns, roles of methods in their order, and rows at most."""


def tables(evidence: Evidence) -> list[Table]:
    """One table for the paper's world with all methods, one for every other world with those that flew in it.

    MuJoCo at 20 ms is a sentence below the first: the same integrator, no independent check.
    """
    places = evidence.places(*MAIN)
    headline = next((where for where in places if where.world.standard), None)
    parity = [where for where in places if where.world.sim == "mujoco" and _same_integrator(evidence, where)]
    others = [where for where in places if where != headline and where not in parity]
    sentences = tuple(filter(None, (_parity(evidence, where) for where in parity)))[:1]
    return [_headline(evidence, headline, sentences), *(_other(evidence, w, n) for n, w in enumerate(others, start=2))]


def _same_integrator(evidence: Evidence, where: Where) -> bool:
    step = evidence.physics_step(where.world)
    return step is not None and bool(np.isclose(step, SAME_STEP))


def _parity(evidence: Evidence, where: Where) -> str:
    """How policies' flights in MuJoCo at 20 ms agree with the same flights in our world; planners' own loops amplify
    the last bits of a number, whatever the world."""
    twin = next((w for w in evidence.places(*MAIN) if w.world == where.world._replace(sim="torch")), None)
    equal = total = 0
    apart = 0.0
    for method, rows in evidence.flew(where).items():
        if method.policy and twin is not None and (own := evidence.rows(method, twin)) is not None:
            pair = stats.paired(own, rows, ("cfr", "fm"))
            equal, total = equal + int((pair["cfr_a"] == pair["cfr_b"]).sum()), total + len(pair)
            gaps = (pair["fm_a"] - pair["fm_b"]).abs()[pair["cfr_a"] & pair["cfr_b"]]
            apart = max(apart, float(gaps.max()) if len(gaps) else 0.0)
    if not total:
        return ""
    return (
        f"MuJoCo at 20 ms takes the same semi-implicit Euler step as our world at 20 ms: of policies' flights in both, "
        f"success is equal in {equal:,} of {total:,}, FM within {apart:.1g} m. It shows parity, not robustness."
    )


def _headline(evidence: Evidence, where: Where | None, sentences: tuple[str, ...]) -> Table:
    """The paper's world: every method that the store or the paper knows, measured or not."""
    shown = list(evidence.expected)
    rows = [_row(evidence, method, where) for method in shown]
    cut = len(rows) - sum(method.role == "sanity" for method in shown)
    known = {method.paper_name for method in shown}
    unknown = {name: _unknown_row(name) for name in published.METHODS if name not in known}
    ours = [unknown.pop("ours")] if "ours" in unknown else []
    ordered = (*ours, *rows[:cut], *unknown.values(), *rows[cut:])
    groups = (len(ours) + cut + len(unknown),) if cut < len(rows) else ()
    label = world_label(evidence, where.world) if where else "balls aimed at a drone, torch world, crazyflie"
    return _table(evidence, "main", "", label, ordered, shown, where, groups, sentences)


def _other(evidence: Evidence, where: Where, number: int) -> Table:
    """Another world: the methods that flew in it."""
    standard = evidence.places(*MAIN)[0].world
    shown = list(evidence.flew(where))
    rows = tuple(_row(evidence, method, where) for method in shown)
    words, usual = world_words(evidence, where.world, standard), world_words(evidence, standard)
    apart = ", ".join(word for word in words if word not in usual)
    if where.world._replace(sim="torch", settings="").standard and where.world.sim == "mujoco":
        apart = f"independent check, {apart}"
    return _table(evidence, f"main_{number}", apart, ", ".join(words), rows, shown, where)


def _table(
    evidence: Evidence,
    key: str,
    apart: str,
    label: str,
    rows: tuple[tuple[Cell, ...], ...],
    shown: list[Method],
    where: Where | None,
    groups: tuple[int, ...] = (),
    sentences: tuple[str, ...] = (),
) -> Table:
    """``apart``: what the title has to say of a world that is not the paper's."""
    used = [(method.key, where) for method in shown] if where else []
    parts = (f"{label[0].upper()}{label[1:]}.", _FM, evidence.satisfaction(used), INTERVALS)
    title = "Mixed obstacles: 10 columns and 2 balls" + (f"; {apart}" if apart else "")
    below = (*sentences, *notes(evidence, used))
    return Table(key, title, " ".join(filter(None, parts)), _COLUMNS, rows, evidence.stamp(used), below, groups)


def _row(evidence: Evidence, method: Method, where: Where | None) -> tuple[Cell, ...]:
    paper = published.published(method.paper_name, "mixed") if method.scene == "mixed" else None
    rows = evidence.rows(method, where) if where else None
    name = Cell(evidence.names[method.key])
    if rows is None:
        return name, MISSING, paper_rate(paper), MISSING, paper_fm(paper), MISSING, MISSING, MISSING
    return (
        name,
        success_cell(rows),
        paper_rate(paper),
        fm_cell(rows),
        paper_fm(paper),
        flag_cell(rows, "cfr_strict"),
        flag_cell(rows, "sr"),
        evidence_cell(method, rows),
    )


def _unknown_row(name: str) -> tuple[Cell, ...]:
    """A method of the paper that the store knows nothing of."""
    paper = published.published(name, "mixed")
    label = Cell(published.METHODS[name])
    return label, MISSING, paper_rate(paper), MISSING, paper_fm(paper), MISSING, MISSING, MISSING


def summary(main: Table, evidence: Evidence) -> tuple[str, ...]:
    """The result in a sentence for each full method, or for our best policy, from the main table's own cells."""
    keys = [column.key for column in main.columns]
    rows = {row[0].text: dict(zip(keys, row, strict=True)) for row in main.rows}
    if not evidence.cells:
        return (f"No episode has been flown under profile {evidence.profile} yet: what follows is the skeleton.",)
    full = [evidence.names[method.key] for method in lookup.full(evidence)]
    lines = [
        f"{name}: {_sentence(rows[name]['cfr'], rows[name]['fm'])}. "
        f"The paper: {_sentence(rows[name]['cfr_paper'], rows[name]['fm_paper'])}."
        for name in full
        if name in rows and rows[name]["cfr"].value is not None
    ]
    if lines:
        return tuple(lines)
    lines.append("The full method of the paper, with weights from a search, has not been flown in the main scene yet.")
    best, _ = lookup.ours(evidence)
    cells = rows.get(evidence.names[best.key]) if best is not None else None
    if best is not None and cells is not None and cells["cfr"].value is not None:
        world = main.caption.partition(".")[0].lower()
        lines.append(f"{evidence.names[best.key]}, {world}: {_sentence(cells['cfr'], cells['fm'])}.")
    return tuple(lines)


def _sentence(cfr: Cell, fm: Cell) -> str:
    """A result in words: CFR 0.914 [0.886, 0.944] (823/900), FM 0.163 m."""
    between, counted = cfr.details[:2] if len(cfr.details) > 1 else ("", "")
    metres = f", FM {fm.text} m" if fm.value is not None else ", no FM"
    return f"CFR {cfr.text} {between} ({counted}){metres}"


def front_page(main: Table, evidence: Evidence) -> Table:
    """The rows and columns of the main table that fit on a front page: the paper's methods, the fair sets, and the
    best agent that avoids nothing."""
    places = [place for place, column in enumerate(main.columns) if column.key in FRONT_COLUMNS]
    measured = {row[0].text: row for row in main.rows if row[1].value is not None}
    roles = {evidence.names[method.key]: method.role for method in evidence.methods.values()}
    names = [name for role in FRONT_ROLES for name in measured if roles.get(name) == role]
    rates = {name: measured[name][1].value or 0 for name in names}
    sanity = sorted((name for name in names if roles[name] == "sanity"), key=lambda name: -rates[name])
    names = [name for name in names if name not in sanity[1:]]
    if not any(roles[name] == "ours" for name in names):
        names = [name for name in measured if roles.get(name) == "other"][:2] + names
    rows = tuple(tuple(measured[name][place] for place in places) for name in names[:FRONT_ROWS])
    return replace(main, columns=tuple(main.columns[place] for place in places), rows=rows, groups=())
