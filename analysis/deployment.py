"""Flights over simulated motion capture and radio: the table that stands for the paper's Table II, and its curves."""

from typing import TYPE_CHECKING, NamedTuple

from analysis import cells, commands, methods, paper, stats
from analysis.cells import Cell, Column, Table
from analysis.evidence import AIMS, Evidence, Where, World, world_words
from analysis.methods import Method
from analysis.stats import Rate
from analysis.tables import unthrown_notes

if TYPE_CHECKING:
    import pandas as pd

TITLE = "Simulated stand-ins for the paper's real flights"

FLIGHTS = 10
"""Flights per cell of the paper's Table II."""

SCENES = {
    "real_static": "Static: 2 columns",
    "real_dynamic": "Dynamic: 1 ball",
    "real_mixed": "Mixed: 2 columns, 1 ball",
}
"""Scenarios of Table II and their names."""

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
"""Quantities of a robustness curve: axis label, and the factor to its unit."""

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


def summary(rows: "pd.DataFrame") -> Summary:
    """A cell's flights; the first ten of its bank play the paper's ten.

    ``least`` and ``most`` come from the beta-binomial law of ten more flights after those flown (uniform prior).
    """
    from scipy.stats import betabinom

    ordered = rows.sort_values(["train_seed"] * ("train_seed" in rows) + ["scenario_id"], kind="stable")
    first = ordered["cfr"].to_numpy(bool)[:FLIGHTS]
    rate = stats.rate(rows["cfr"].to_numpy(bool), rows["train_seed"].to_numpy() if "train_seed" in rows else None)
    law = betabinom(FLIGHTS, rate.k + 1, rate.n - rate.k + 1)
    flown = rows.loc[rows["cfr"].to_numpy(bool), "fm"]
    fm = float(flown.mean()) if len(flown) else None
    return Summary(int(first.sum()), len(first), rate, int(law.ppf(0.025)), int(law.ppf(0.975)), fm)


def table(evidence: Evidence) -> Table:
    """Table II's scenes: the paper's ten flights, and ours with the disturbances of a deployment."""
    rows: list[tuple[Cell, ...]] = []
    used: list[tuple[str, Where]] = []
    starts = []
    shared = _shared(evidence)
    for scenario, title in SCENES.items():
        starts.append(len(rows))
        known = [published for published in paper.REAL if published.scenario == scenario]
        for published in known:
            printed = cells.paper_rate(published)
            flown = [(m, w) for m, w in _flown(evidence, scenario) if m.paper_name == published.method]
            for method, where in flown:
                head = (Cell(title), Cell(evidence.names[method.key]), printed)
                rows.append(_row(evidence, head, method, where, shared))
                used.append((method.key, where))
            if not flown:
                head = (Cell(title), Cell(methods.LABELS.get(published.method, "Ours")), printed)
                gap = cells.missing_cell(command(evidence, published.method))
                rows.append((*head, gap, gap, gap, gap, gap, gap if gap.command else Cell("no such agent here")))
        names = {published.method for published in known}
        for method, where in _flown(evidence, scenario):
            if method.paper_name not in names:
                head = (Cell(title), Cell(evidence.names[method.key]), Cell(cells.NOTHING, paper=True))
                rows.append(_row(evidence, head, method, where, shared))
                used.append((method.key, where))
    caption = (
        "The paper flew ten times each; ours are simulated, at 500 Hz, behind motion capture and radio. Ten flights: "
        "the first ten of the bank. Ten could show: what ten flights show with 95 % probability. "
        "Square brackets: 95 % intervals."
    )
    if shared:
        caption += f" All flights here: {', '.join(shared)}."
    stamp, notes = evidence.stamp(used), unthrown_notes(evidence, used)
    return Table("deployment", TITLE, caption, _COLUMNS, tuple(rows), stamp, notes, tuple(starts))


def curves(evidence: Evidence) -> "pd.DataFrame":
    """One row per method, varied quantity and value: CFR and FM with intervals, of at least one ``curve_cells``.

    Columns: axis, world, method, value, cfr, cfr_low, cfr_high, k, n, seeds, fm, fm_low, fm_high, fm_n.
    """
    import pandas as pd

    from analysis.series import point

    records = []
    for method, where, axis, value in _varied(evidence):
        rows = evidence.cells[method.key, where]
        world = f"{where.scenario}, {where.world.deploy.split()[0]}, {where.world.sim}"
        name = evidence.names[method.key]
        records.append({"axis": axis, "world": world, "method": name, "value": value} | point(rows))
    return pd.DataFrame(records).sort_values(["axis", "world", "method", "value"], ignore_index=True)


def curve_cells(evidence: Evidence) -> list[tuple[str, Where]]:
    """The cells that the curves are made of, for their stamp."""
    return [(method.key, where) for method, where, _, _ in _varied(evidence)]


def curve_command(evidence: Evidence) -> str:
    """What to type for the curves."""
    return f"{command(evidence, 'ours')} --curves"


def _varied(evidence: Evidence) -> list[tuple[Method, Where, str, float]]:
    """Cells whose deployment is named after one changed value: ``mocap latency=0.04``."""
    found = []
    for (key, where), _ in evidence.cells.items():
        axis, is_varied, value = where.world.deploy.partition(" ")[2].partition("=")
        if is_varied and axis in AXES and evidence.methods[key] in evidence.shown:
            found.append((evidence.methods[key], where, axis, float(value)))
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
    worlds = [where.world for scenario in SCENES for _, where in _flown(evidence, scenario)]
    told = [{*_words(evidence, world), *(() if world.ball_aim else AIMS.values())} for world in worlds]
    words = dict.fromkeys(word for world in worlds for word in _words(evidence, world) if word != f"{world.sim} world")
    return tuple(word for word in words if all(word in known for known in told))


def _row(
    evidence: Evidence, head: tuple[Cell, ...], method: Method, where: Where, shared: tuple[str, ...]
) -> tuple[Cell, ...]:
    from analysis.tables import fm, on_what, rate

    rows = evidence.cells[method.key, where]
    seen = summary(rows)
    share = seen.ten / seen.tried
    ten = Cell(f"{share:.1f}", (cells.interval(*stats.wilson(seen.ten, seen.tried), digits=2),), share)
    world = Cell(", ".join(word for word in _words(evidence, where.world) if word not in shared))
    range_ = Cell(f"{seen.least} to {seen.most} of {FLIGHTS}")
    return (*head, ten, rate(rows, "cfr"), range_, fm(rows), world, on_what(method, rows))


def command(evidence: Evidence, name: str) -> str:
    """What flies a method of the paper in all scenes; empty where this version has no such baseline."""
    if name != "ours":
        return commands.deploy_baseline(evidence, name)
    trained = next((method for method in evidence.methods.values() if method.role == "ours"), None)
    if trained is not None:
        return commands.deploy(evidence, trained)
    return commands.train_and_deploy(evidence)
