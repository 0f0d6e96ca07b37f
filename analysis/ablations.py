"""Tables that hold methods against each other: the two ablations (paper, Sec. VI-C) and paired comparisons."""

from typing import TYPE_CHECKING

import numpy as np

from analysis import cells, commands, flown, methods, stats, verdicts
from analysis.cells import Cell, Column, Table
from analysis.evidence import Evidence, Where
from analysis.methods import Method
from analysis.tables import INTERVALS, headline_place, learnt, on_what, rate, seed_notes

if TYPE_CHECKING:
    import pandas as pd

OBJECTIVES = ("formation", "flight", "obstacle", "action")

_PAIRED = (
    "Differences, first minus other, with paired bootstrap intervals over shared episodes (and seeds). p: exact "
    "McNemar, Holm-adjusted over this table; with several seeds the largest of their p values, 1 where they disagree "
    "on who is better. All FM here on the episodes that both finished, that is in which both succeeded, each flight "
    "counted once; a negative difference is tighter."
)
_PAIRED_COLUMNS = (
    Column("method", "Other method", left=True, wide=0.2),
    Column("cfr_difference", "ΔCFR"),
    Column("p_holm", "p (Holm)"),
    Column("fm_difference", "ΔFM (m)"),
    Column("fm_first", "FM (m), first"),
    Column("fm_other", "FM (m), other"),
)


def encoder(evidence: Evidence) -> Table:
    """The encoder's arms with the full curriculum: success rate of each objective, SR and CFR (Sec. VI-C1)."""
    arms = [(name, encoder, "three_period") for encoder, name in methods.ENCODERS.items()]
    return _ablation(evidence, "ablation_encoder", "Observation encoder", arms)


def curriculum(evidence: Evidence) -> Table:
    """The curriculum's arms with the full encoder: success rate of each objective, SR and CFR (Sec. VI-C2)."""
    arms = [(name, "attention", curriculum) for curriculum, name in methods.CURRICULA.items()]
    return _ablation(evidence, "ablation_curriculum", "Curriculum", arms)


def compare(evidence: Evidence) -> Table | None:
    """Our best method against every other on the episodes both flew; None where there is nothing to pair."""
    where = headline_place(evidence)
    best = flown.best(evidence, where) if where else None
    if where is None or best is None:
        return None
    others = [m for m in evidence.shown if m is not best and evidence.rows(m, where) is not None]
    first = evidence.cells[best.key, where]
    pairs = {method: flown.paired(first, evidence.cells[method.key, where], ("cfr", "fm")) for method in others}
    pairs = {method: pair for method, pair in pairs.items() if len(pair)}
    if not pairs:
        return None
    contests = verdicts.contests(first, [evidence.cells[method.key, where] for method in pairs])
    rows = []
    for (method, pair), contest in zip(pairs.items(), contests, strict=True):
        name = Cell(evidence.names[method.key], _seeds(evidence, where, (best, method), pair))
        rows.append((name, *_paired_cells(pair, contest.p)))
    title = f"{evidence.names[best.key]} against every other method, on the same episodes"
    used = [(method.key, where) for method in (best, *pairs)]
    stamp, notes = evidence.stamp(used), seed_notes(evidence, used)
    return Table("paired", title, _PAIRED, _PAIRED_COLUMNS, tuple(rows), stamp, notes)


def _ablation(evidence: Evidence, key: str, title: str, arms: list[tuple[str, str, str]]) -> Table:
    where = headline_place(evidence)
    rows: list[tuple[Cell, ...]] = []
    used: list[Method] = []
    for name, encoder, curriculum in arms:
        found = _flown(evidence, encoder, curriculum, where)
        for method in found:
            assert where is not None
            label = Cell(name, (evidence.names[method.key],) if len(found) > 1 else ())
            rows.append(_arm_row(label, method, evidence.cells[method.key, where]))
        used += found
        if not found:
            gap = cells.missing_cell(commands.train_and_fly(evidence, encoder, curriculum))
            rows.append((Cell(name), *[gap] * 7))
    budgets = {method.facts.steps for method in used}
    shown = ", ".join(methods.short(steps) for steps in sorted(budgets, key=lambda steps: steps or 0))
    notes = (f"Training budgets differ ({shown} steps): compare equal ones only.",) if len(budgets) > 1 else ()
    columns = (
        Column("arm", title, left=True),
        *[Column(f"ok_{objective}", objective.capitalize()) for objective in OBJECTIVES],
        Column("sr", "SR ↑"),
        Column("cfr", "CFR ↑"),
        Column("evidence", "Evidence", left=True),
    )
    caption = f"Share of episodes in the main scene that satisfy each objective, and all four (SR). {INTERVALS}"
    flights = [(method.key, where) for method in used] if where else []
    stamp, notes = evidence.stamp(flights), (*notes, *seed_notes(evidence, flights))
    return Table(key, f"Ablation: {title.lower()}", caption, columns, tuple(rows), stamp, notes)


def _flown(evidence: Evidence, encoder: str, curriculum: str, where: Where | None) -> list[Method]:
    if where is None:
        return []
    return [m for m in flown.arms(evidence, encoder, curriculum) if evidence.rows(m, where) is not None]


def _arm_row(label: Cell, method: Method, rows: "pd.DataFrame") -> tuple[Cell, ...]:
    objectives = [rate(rows, f"ok_{name}") for name in OBJECTIVES]
    return (label, *objectives, rate(rows, "sr"), rate(rows, "cfr"), on_what(method, rows))


def _seeds(evidence: Evidence, where: Where, sides: tuple[Method, Method], pair: "pd.DataFrame") -> tuple[str, ...]:
    """How many seeds of each side are paired, and of how many; nothing where neither side has more than one."""
    flown = [evidence.cells[method.key, where]["train_seed"].nunique() for method in sides]
    if max(flown) == 1:
        return ()
    paired = [pair[f"train_seed_{side}"].nunique() for side in "ab"]
    words = [f"{n}" if n == of else f"{n} of {of}" for n, of in zip(paired, flown, strict=True)]
    first, other = (text if learnt(method) else cells.NOTHING for text, method in zip(words, sides, strict=True))
    return (f"seeds: {first} against {other}",)


def _paired_cells(pair: "pd.DataFrame", p: float) -> tuple[Cell, ...]:
    cfr = pair.assign(value=pair["cfr_a"].astype(float) - pair["cfr_b"].astype(float))
    both = pair["cfr_a"] & pair["cfr_b"]
    fm = pair.assign(value=(pair["fm_a"] - pair["fm_b"]).where(both, np.nan))
    seeds = pair["pair"].nunique()
    p_cell = Cell(_p_text(p), () if seeds == 1 else (f"weakest of {seeds}",), float(p))
    cfr_cell = cells.difference_cell(stats.paired_rate_difference(_matrix(cfr)))
    fm_cell = cells.difference_cell(stats.paired_difference(_matrix(fm)))
    return (cfr_cell, p_cell, fm_cell, _own_fm(pair[both], "a"), _own_fm(pair[both], "b"))


def _own_fm(shared: "pd.DataFrame", side: str) -> Cell:
    """FM (m) of one side (``a`` | ``b``); a flight paired with several seeds of the other side counts once."""
    own = shared.drop_duplicates([f"train_seed_{side}", "draw", "scenario_id"])
    return cells.mean_cell(stats.mean(own[f"fm_{side}"].to_numpy(float), own[f"train_seed_{side}"]))


def _matrix(frame: "pd.DataFrame") -> np.ndarray:
    """Differences as (seeds, episodes)."""
    return frame.pivot(index="pair", columns=["draw", "scenario_id"], values="value").to_numpy(float)


def _p_text(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"{p:.3f}"
