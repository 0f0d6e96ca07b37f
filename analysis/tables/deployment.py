"""Flights over simulated motion capture and radio: the table that stands for the paper's Table II, and its curves."""

from typing import NamedTuple

import pandas as pd
from scipy.stats import betabinom

from analysis import stats
from analysis.data import published
from analysis.data.evidence import AIMS, Evidence, Where, World, world_words
from analysis.data.methods import Method
from analysis.data.published import FLIGHTS, REAL_SCENES
from analysis.stats import Rate
from analysis.tables.notes import notes
from analysis.tables.table import (
    MISSING,
    NOTHING,
    Cell,
    Column,
    Table,
    evidence_cell,
    fm_cell,
    interval,
    paper_rate,
    success_cell,
)

TITLE = "Simulated stand-ins for the paper's real flights"

AXES = {
    "latency": ("Latency (ms)", 1e3),
    "position_noise": ("Position noise (mm)", 1e3),
    "mass": ("Mass, of the model's", 1.0),
    "motor_lag": ("Motor lag, of the model's", 1.0),
    "packet_loss": ("Lost packets (%)", 1e2),
    "thrust": ("Thrust, of the model's", 1.0),
    "attitude_noise": ("Attitude noise (mrad)", 1e3),
    "ball_noise": ("Ball noise (mm)", 1e3),
}
"""Quantities of a robustness curve: axis label, and the factor to its unit; any other is shown as it is."""

_COLUMNS = (
    Column("scenario", "Scenario", left=True, wide=0.1),
    Column("method", "Method", left=True, wide=0.12),
    Column("cfr_paper", "CFR, paper"),
    Column("cfr_ten", "CFR, ten here"),
    Column("cfr", "CFR, all here"),
    Column("ten_could_show", "Ten could show", left=True),
    Column("fm", "FM (m)"),
    Column("world", "World", left=True, wide=0.14),
    Column("evidence", "Evidence", left=True),
)


class Summary(NamedTuple):
    """Flights of one method in one scene."""

    ten: int  # successes among the first ``tried``
    tried: int
    rate: Rate  # of all
    least: int  # successes that ten further flights show with 95 % probability, from
    most: int  # and up to
    fm: float | None  # m, over successful flights


class Varied(NamedTuple):
    """A cell whose deployment is named after one changed value."""

    method: Method
    where: Where
    axis: str
    value: float


def summary(rows: pd.DataFrame) -> Summary:
    """A cell's flights; the first ten of its bank play the paper's ten.

    ``least`` and ``most`` come from the beta-binomial law of ten more flights after those flown (uniform prior).
    """
    ordered = rows.sort_values(["train_seed"] * ("train_seed" in rows) + ["scenario_id"], kind="stable")
    first = ordered["cfr"].to_numpy(bool)[:FLIGHTS]
    rate = stats.rate(rows["cfr"].to_numpy(bool), rows["train_seed"].to_numpy() if "train_seed" in rows else None)
    law = betabinom(FLIGHTS, rate.k + 1, rate.n - rate.k + 1)
    successes = rows.loc[rows["cfr"].to_numpy(bool), "fm"]
    fm = float(successes.mean()) if len(successes) else None
    return Summary(int(first.sum()), len(first), rate, int(law.ppf(0.025)), int(law.ppf(0.975)), fm)


def table(evidence: Evidence) -> Table:
    """Table II's scenes: the paper's ten flights, and ours with the disturbances of a deployment.

    The paper's own row is held against the policies that were trained for real flights.
    """
    rows: list[tuple[Cell, ...]] = []
    used: list[tuple[str, Where]] = []
    starts = []
    shared = _shared(evidence)
    for scenario, title in REAL_SCENES.items():
        starts.append(len(rows))
        known = {cell.method: cell for cell in published.REAL if cell.scenario == scenario}
        flown = _flown(evidence, scenario)
        for name, paper in known.items():
            own = [(method, where) for method, where in flown if _real_name(method) == name]
            rows += [_row(evidence, title, paper_rate(paper), method, where, shared) for method, where in own]
            if not own:
                label = published.METHODS[name]
                rows.append((Cell(title), Cell(label), paper_rate(paper), *[MISSING] * 6))
        rest = [(method, where) for method, where in flown if _real_name(method) not in known]
        nothing = Cell(NOTHING, paper=True)
        rows += [_row(evidence, title, nothing, method, where, shared) for method, where in rest]
        used += [(method.key, where) for method, where in flown]
    caption = (
        "The paper flew ten times each; ours are simulated, behind motion capture and radio. Ten flights: the first "
        "ten of the bank. Ten could show: what ten flights show with 95 % probability. Square brackets: 95 % intervals."
    )
    if shared:
        caption += f" All flights here: {', '.join(shared)}."
    below = notes(evidence, used)
    return Table("deployment", TITLE, caption, _COLUMNS, tuple(rows), evidence.stamp(used), below, tuple(starts))


def curves(evidence: Evidence) -> pd.DataFrame:
    """One row per method, varied quantity and value: CFR and FM with intervals, of at least one ``curve_cells``.

    Columns: axis, world, method, value, cfr, cfr_low, cfr_high, k, n, seeds, fm, fm_low, fm_high, fm_n.
    """
    records = []
    for method, where, axis, value in _varied(evidence):
        world = f"{where.scenario}, {where.world.deploy.split()[0]}, {where.world.sim}"
        place = {"axis": axis, "world": world, "method": evidence.names[method.key], "value": value}
        records.append(place | point(evidence.cells[method.key, where]))
    return pd.DataFrame(records).sort_values(["axis", "world", "method", "value"], ignore_index=True)


def curve_cells(evidence: Evidence) -> list[tuple[str, Where]]:
    """The cells that the curves are made of, for their stamp."""
    return [(varied.method.key, varied.where) for varied in _varied(evidence)]


def point(rows: pd.DataFrame) -> dict[str, float]:
    """CFR and FM of some episodes with intervals and counts, as columns of a figure's data."""
    cfr, fm = stats.rate_of(rows), stats.fm_of(rows)
    values = {"cfr": cfr.value, "cfr_low": cfr.low, "cfr_high": cfr.high, "k": cfr.k, "n": cfr.n, "seeds": cfr.seeds}
    value, low, high, n = (fm.value, fm.low, fm.high, fm.n) if fm else (float("nan"),) * 3 + (0,)
    return values | {"fm": value, "fm_low": low, "fm_high": high, "fm_n": n}


def _real_name(method: Method) -> str:
    """What Table II calls a method; empty for policies that were not trained for its scenes."""
    return method.paper_name if method.for_flight or not method.policy else ""


def _varied(evidence: Evidence) -> list[Varied]:
    found = []
    for key, where in evidence.cells:
        axis, changed, value = where.world.deploy.partition(" ")[2].partition("=")
        if changed and evidence.methods[key] in evidence.shown:
            found.append(Varied(evidence.methods[key], where, axis, float(value)))
    return found


def _flown(evidence: Evidence, scenario: str) -> list[tuple[Method, Where]]:
    """Methods and their worlds of a scene, disturbed ones before others; points of curves are left to the figure."""
    places = [where for where in evidence.places(scenario) if " " not in where.world.deploy]
    flown = [(m, w) for m in evidence.methods.values() for w in places if evidence.rows(m, w) is not None]
    return sorted(flown, key=lambda pair: not pair[1].world.deploy)


def _words(evidence: Evidence, world: World) -> tuple[str, ...]:
    return (*world_words(evidence, world), *(() if world.deploy else ("undisturbed",)))


def _shared(evidence: Evidence) -> tuple[str, ...]:
    """Words that hold for all flights, whatever is said of balls only where some are thrown; never the simulator."""
    worlds = [where.world for scenario in REAL_SCENES for _, where in _flown(evidence, scenario)]
    known = [{*_words(evidence, world), *(() if world.ball_aim else AIMS.values())} for world in worlds]
    words = dict.fromkeys(word for world in worlds for word in _words(evidence, world) if " world" not in word)
    return tuple(word for word in words if all(word in each for each in known))


def _row(
    evidence: Evidence, title: str, paper: Cell, method: Method, where: Where, shared: tuple[str, ...]
) -> tuple[Cell, ...]:
    rows = evidence.cells[method.key, where]
    seen = summary(rows)
    share = seen.ten / seen.tried
    ten = Cell(f"{share:.1f}", (interval(*stats.wilson(seen.ten, seen.tried), digits=2),), share)
    world = Cell(", ".join(word for word in _words(evidence, where.world) if word not in shared))
    could = Cell(f"{seen.least} to {seen.most} of {FLIGHTS}")
    head = (Cell(title), Cell(evidence.names[method.key]), paper)
    return (*head, ten, success_cell(rows), could, fm_cell(rows), world, evidence_cell(method, rows))
