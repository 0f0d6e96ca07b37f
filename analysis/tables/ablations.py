"""Tables that hold methods against each other: the two ablations (paper, Sec. VI-C) and paired comparisons."""

import numpy as np
import pandas as pd

from analysis import stats
from analysis.data import lookup, methods
from analysis.data.evidence import Evidence, Where
from analysis.data.methods import Method
from analysis.data.published import CURRICULA, ENCODERS
from analysis.data.text import short
from analysis.tables.notes import notes, one_seed
from analysis.tables.table import (
    INTERVALS,
    MISSING,
    NOTHING,
    Cell,
    Column,
    Table,
    difference_cell,
    evidence_cell,
    flag_cell,
    mean_cell,
    p_text,
    success_cell,
)
from envs.vocabulary import OBJECTIVES

_PAIRED = (
    "Differences, first minus other, with paired bootstrap intervals over shared episodes (and seeds). p: exact "
    "McNemar, Holm-adjusted over this table; with several seeds the largest of their p values, 1 where they disagree "
    "on who is better. All FM here on the episodes in which both succeeded, each flight counted once; a negative "
    "difference is tighter. Of another policy it is said what else than chance sets it apart."
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
    arms = [(name, encoder, "three_period") for encoder, name in ENCODERS.items()]
    return _ablation(evidence, "ablation_encoder", "Observation encoder", arms)


def curriculum(evidence: Evidence) -> Table:
    """The curriculum's arms with the full encoder: success rate of each objective, SR and CFR (Sec. VI-C2)."""
    arms = [(name, "attention", curriculum) for curriculum, name in CURRICULA.items()]
    return _ablation(evidence, "ablation_curriculum", "Curriculum", arms)


def paired_table(evidence: Evidence) -> Table | None:
    """Our best method against every other on the episodes both flew; None where there is nothing to pair."""
    where = lookup.main_place(evidence)
    best = lookup.best(evidence, where) if where else None
    if where is None or best is None:
        return None
    first = evidence.cells[best.key, where]
    flown = {m: rows for m, rows in evidence.flew(where).items() if m is not best}
    pairs = {m: pair for m, rows in flown.items() if len(pair := stats.paired(first, rows, ("cfr", "fm")))}
    if not pairs:
        return None
    tests = stats.compare(first, [flown[method] for method in pairs])
    rows = []
    for (method, pair), test in zip(pairs.items(), tests, strict=True):
        details = (*_seeds(evidence, where, (best, method), pair), *_apart(best, method))
        rows.append((Cell(evidence.names[method.key], details), *_paired_cells(pair, test.p)))
    title = f"{evidence.names[best.key]} against every other method, on the same episodes"
    used = [(method.key, where) for method in (best, *pairs)]
    below = one_seed(evidence, used)
    return Table("paired", title, _PAIRED, _PAIRED_COLUMNS, tuple(rows), evidence.stamp(used), below)


def _ablation(evidence: Evidence, key: str, title: str, arms: list[tuple[str, str, str]]) -> Table:
    where = lookup.main_place(evidence)
    rows: list[tuple[Cell, ...]] = []
    used: list[Method] = []
    for name, encoder, curriculum in arms:
        known = lookup.arms(evidence, encoder, curriculum) if where else []
        flown = [(m, cell) for m in known if where and (cell := evidence.rows(m, where)) is not None]
        for method, cell in flown:
            label = Cell(name, (evidence.names[method.key],) if len(flown) > 1 else ())
            objectives = [flag_cell(cell, f"ok_{objective}") for objective in OBJECTIVES]
            rates = (*objectives, flag_cell(cell, "sr"), success_cell(cell))
            rows.append((label, *rates, evidence_cell(method, cell)))
        used += [method for method, _ in flown]
        if not flown:
            rows.append((Cell(name), *[MISSING] * 7))
    budgets = {method.facts.steps for method in used}
    shown = ", ".join(short(steps) for steps in sorted(budgets, key=lambda steps: steps or 0))
    unequal = (f"Training budgets differ ({shown} steps): compare equal ones only.",) if len(budgets) > 1 else ()
    columns = (
        Column("arm", title, left=True),
        *[Column(f"ok_{objective}", objective.capitalize()) for objective in OBJECTIVES],
        Column("sr", "SR ↑"),
        Column("cfr", "CFR ↑"),
        Column("evidence", "Evidence", left=True),
    )
    flights = [(method.key, where) for method in used] if where else []
    parts = (
        "Share of episodes in the main scene that satisfy each objective, and all four (SR).",
        evidence.satisfaction(flights),
        INTERVALS,
    )
    below = (*unequal, *notes(evidence, flights))
    caption = " ".join(filter(None, parts))
    return Table(key, f"Ablation: {title.lower()}", caption, columns, tuple(rows), evidence.stamp(flights), below)


def _apart(first: Method, other: Method) -> tuple[str, ...]:
    """Between two policies: what differs in how they were trained, since the comparison changes all of it at once."""
    if not (first.policy and other.policy) or not (first.settings and other.settings):
        return ()
    groups = methods.changed(first, other)
    budget = {"train"} if first.facts.steps != other.facts.steps else set()
    words = {"algo": "learner", "train": "steps"}
    listed = [words.get(group, group) for group in sorted((groups - {"train"}) | budget)]
    return (f"differs in {', '.join(listed)}",) if listed else ()


def _seeds(evidence: Evidence, where: Where, sides: tuple[Method, Method], pair: pd.DataFrame) -> tuple[str, ...]:
    """How many seeds of each side are paired, and of how many; nothing where neither side has more than one."""
    flown = [evidence.cells[method.key, where]["train_seed"].nunique() for method in sides]
    if max(flown) == 1:
        return ()
    counts = [pair[f"train_seed_{side}"].nunique() for side in "ab"]
    words = [f"{n}" if n == of else f"{n} of {of}" for n, of in zip(counts, flown, strict=True)]
    first, other = (text if method.facts.learnt else NOTHING for text, method in zip(words, sides, strict=True))
    return (f"seeds: {first} against {other}",)


def _paired_cells(pair: pd.DataFrame, p: float) -> tuple[Cell, ...]:
    cfr = pair.assign(value=pair["cfr_a"].astype(float) - pair["cfr_b"].astype(float))
    both = pair["cfr_a"] & pair["cfr_b"]
    fm = pair.assign(value=(pair["fm_a"] - pair["fm_b"]).where(both, np.nan))
    seeds = pair["pair"].nunique()
    p_cell = Cell(p_text(p), () if seeds == 1 else (f"weakest of {seeds}",), float(p))
    cfr_cell = difference_cell(stats.paired_rate_difference(_matrix(cfr)))
    fm_cell = difference_cell(stats.paired_difference(_matrix(fm)))
    return (cfr_cell, p_cell, fm_cell, _own_fm(pair[both], "a"), _own_fm(pair[both], "b"))


def _own_fm(shared: pd.DataFrame, side: str) -> Cell:
    """FM (m) of one side (``a`` | ``b``); a flight paired with several seeds of the other side counts once."""
    own = shared.drop_duplicates([f"train_seed_{side}", "draw", "scenario_id"])
    return mean_cell(stats.mean(own[f"fm_{side}"].to_numpy(float), own[f"train_seed_{side}"]))


def _matrix(frame: pd.DataFrame) -> np.ndarray:
    """Differences as (seeds, episodes)."""
    return frame.pivot(index="pair", columns=["draw", "scenario_id"], values="value").to_numpy(float)
