"""The report's main tables, built from one profile's evidence, and the notes that any of its tables may need."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from analysis import cells, commands, methods, paper, stats
from analysis.cells import Cell, Column, Table
from analysis.evidence import Evidence, Where, World, world_label, world_words
from analysis.methods import Method

if TYPE_CHECKING:
    import pandas as pd

MAIN = ("mixed", 10, 2)
"""The paper's main scene: scenario, columns, balls (Table I)."""

INTERVALS = "Square brackets: 95 % intervals (Wilson; with several seeds two-level bootstrap over seeds and episodes)."
UNTHROWN = 0.1
"""Share of a method's successes without any ball in the air from which a table with balls tells it."""

_FM = "FM: episode mean of the unnormalised Laplacian distance, over collision-free episodes that reached the goal."

_MAIN_COLUMNS = (
    Column("method", "Method", left=True, wide=0.16),
    Column("cfr", "CFR ↑"),
    Column("cfr_paper", "CFR, paper"),
    Column("fm", "FM (m) ↓"),
    Column("fm_paper", "FM, paper"),
    Column("cfr_strict", "CFR, strict radius"),
    Column("sr", "SR ↑"),
    Column("evidence", "Evidence", left=True),
)


def main(evidence: Evidence) -> list[Table]:
    """Table I, the paper's numbers beside ours: one table for the paper's world, one for every other world flown."""
    places = evidence.places(*MAIN)
    headline = next((where for where in places if is_headline(where.world)), None)
    others = [where for where in places if where != headline]
    return [_headline(evidence, headline), *(_other_world(evidence, w, n) for n, w in enumerate(others, start=2))]


def headline_place(evidence: Evidence) -> Where | None:
    """The main scene in the paper's world; the next best world where that was never flown; None if neither."""
    return next(iter(evidence.places(*MAIN)), None)


def is_headline(world: World) -> bool:
    """True for the paper's world: balls aimed at a drone, the torch world, three Crazyflies, no disturbances."""
    found = (world.ball_aim, world.sim, world.drone, world.drones, world.deploy)
    return found == ("drone", "torch", "crazyflie", 3, "")


def rate(rows: "pd.DataFrame", column: str) -> Cell:
    """A cell with the share of episodes whose flag ``column`` is set."""
    return cells.rate_cell(stats.rate(rows[column].to_numpy(bool), rows["train_seed"].to_numpy()))


def fm(rows: "pd.DataFrame") -> Cell:
    """A cell with FM (m) over the successful episodes."""
    successes = rows[rows["cfr"].to_numpy(bool)]
    return cells.mean_cell(stats.mean(successes["fm"].to_numpy(float), successes["train_seed"].to_numpy()))


def learnt(method: Method) -> bool:
    """Whether a method was trained: a policy, or a learnt baseline."""
    return method.facts.learnt


def on_what(method: Method, rows: "pd.DataFrame") -> Cell:
    """A cell that says what a row rests on: episodes and, of a learnt method, seeds and training steps."""
    episodes = f"{len(rows):,} episodes"
    if not learnt(method):
        return Cell(episodes)
    seeds, published = rows["train_seed"].nunique(), method.facts.published_steps
    share = f" of {methods.short(published)} published" if published else ""
    budget = f"{methods.short(method.facts.steps)} steps{share}"
    return Cell(episodes, ("one seed" if seeds == 1 else f"{seeds} seeds", budget))


def seed_notes(evidence: Evidence, used: Iterable[tuple[str, Where]]) -> tuple[str, ...]:
    """One line that names the learnt methods of which one seed was flown, in these cells or in part of them."""
    seeds: dict[str, set[int]] = {}
    for key, where in used:
        if (key, where) in evidence.cells and learnt(evidence.methods[key]):
            seeds.setdefault(key, set()).add(evidence.cells[key, where]["train_seed"].nunique())
    single = [evidence.names[key] + " (in part)" * (counts != {1}) for key, counts in seeds.items() if 1 in counts]
    if not single:
        return ()
    return (f"One training seed: {'; '.join(single)}. The interval speaks about that policy, not about the method.",)


def unthrown_notes(evidence: Evidence, used: Iterable[tuple[str, Where]]) -> tuple[str, ...]:
    """One line that names the methods so fast that in a good part of their successes, in these cells, no ball flew."""
    arrived: dict[str, tuple[int, int]] = {}
    for key, where in used:
        rows = evidence.cells.get((key, where))
        if rows is not None and where.balls and "min_ball" in rows:
            unmet = rows.loc[rows["cfr"].to_numpy(bool), "min_ball"].isna()
            before, count = arrived.get(key, (0, 0))
            arrived[key] = before + int(unmet.sum()), count + len(unmet)
    fast = [(evidence.names[key], k, n) for key, (k, n) in arrived.items() if k > UNTHROWN * n]
    if not fast:
        return ()
    told = "; ".join(f"{name} in {k:,} of {n:,}" for name, k, n in fast)
    return (f"At the goal before any ball was thrown: {told} successful flights.",)


def _headline(evidence: Evidence, where: Where | None) -> Table:
    """The paper's world: every method that the store or the paper knows, measured or not."""
    shown = list(evidence.expected)
    rows = [_main_row(evidence, method, where) for method in shown]
    sanity = sum(method.role == "sanity" for method in shown)
    known = {method.paper_name for method in shown}
    unknown = [name for name in paper.METHODS if name not in known]
    cut = len(rows) - sanity
    ours = [_unknown_row(evidence, name) for name in unknown if name == "ours"]
    rest = [_unknown_row(evidence, name) for name in unknown if name != "ours"]
    ordered = (*ours, *rows[:cut], *rest, *rows[cut:])
    label = world_label(evidence, where.world) if where else "balls aimed at a drone, torch world, crazyflie"
    groups = (len(ordered) - sanity,) if sanity else ()
    return _main_table(evidence, "main", label, ordered, shown, where, groups)


def _other_world(evidence: Evidence, where: Where, number: int) -> Table:
    """Another world: the methods that flew in it."""
    standard = evidence.places(*MAIN)[0].world
    shown = [method for method in evidence.shown if evidence.rows(method, where) is not None]
    rows = tuple(_main_row(evidence, method, where) for method in shown)
    words, usual = world_words(evidence, where.world, standard), world_words(evidence, standard)
    apart = ", ".join(word for word in words if word not in usual)
    return _main_table(evidence, f"main_{number}", ", ".join(words), rows, shown, where, (), apart)


def _main_table(
    evidence: Evidence,
    key: str,
    label: str,
    rows: tuple[tuple[Cell, ...], ...],
    shown: list[Method],
    where: Where | None,
    groups: tuple[int, ...],
    apart: str = "",
) -> Table:
    """``apart``: what the title has to say of a world that is not the paper's."""
    caption = f"{label[0].upper()}{label[1:]}. {_FM} {INTERVALS}"
    used = [(method.key, where) for method in shown] if where else []
    title = "Mixed obstacles: 10 columns and 2 balls" + (f"; {apart}" if apart else "")
    stamp, notes = evidence.stamp(used), (*unthrown_notes(evidence, used), *seed_notes(evidence, used))
    return Table(key, title, caption, _MAIN_COLUMNS, rows, stamp, notes, groups)


def _main_row(evidence: Evidence, method: Method, where: Where | None) -> tuple[Cell, ...]:
    published = paper.published(method.paper_name, "mixed")
    rows = evidence.rows(method, where) if where else None
    name = Cell(evidence.names[method.key])
    if rows is None:
        return _gaps(name, commands.fly(evidence, method, ["scenario=mixed"]), published)
    return (
        name,
        rate(rows, "cfr"),
        cells.paper_rate(published),
        fm(rows),
        cells.paper_fm(published),
        rate(rows, "cfr_strict"),
        rate(rows, "sr"),
        on_what(method, rows),
    )


def _unknown_row(evidence: Evidence, name: str) -> tuple[Cell, ...]:
    """A method of the paper that the store knows nothing of."""
    published = paper.published(name, "mixed")
    if name == "ours":
        return _gaps(Cell("Ours"), commands.train_and_fly(evidence, "attention", "three_period"), published)
    return _gaps(Cell(methods.LABELS[name]), commands.fly_baseline(evidence, name, ["scenario=mixed"]), published)


def _gaps(name: Cell, command: str, published: paper.Published | None) -> tuple[Cell, ...]:
    gap = cells.missing_cell(command)
    last = gap if command else Cell("no such agent here")
    return (name, gap, cells.paper_rate(published), gap, cells.paper_fm(published), gap, gap, last)
