"""Lines that any table or figure may need below it: one training seed, flights without a ball, flights too slow."""

from collections.abc import Iterable

from analysis.data.evidence import Evidence, Where

UNTHROWN = 0.1
"""Share of a method's successes without any ball in the air from which it is said."""
LATE = 0.5
"""Share of a method's flights that fail by being late from which it is said."""
STOPPED = 0.05
"""Of that speed, in m/s below it, nobody says anything: who hovers is not late."""

Cells = Iterable[tuple[str, Where]]


def notes(evidence: Evidence, used: Cells) -> tuple[str, ...]:
    """All of them, of these cells."""
    cells = [cell for cell in used if cell in evidence.cells]
    return (*slow(evidence, cells), *unthrown(evidence, cells), *one_seed(evidence, cells))


def one_seed(evidence: Evidence, used: Cells) -> tuple[str, ...]:
    """One line that names the learnt methods of which one seed was flown, in these cells or in part of them."""
    seeds: dict[str, set[int]] = {}
    for key, where in used:
        if (key, where) in evidence.cells and evidence.methods[key].facts.learnt:
            seeds.setdefault(key, set()).add(evidence.cells[key, where]["train_seed"].nunique())
    single = [evidence.names[key] + " (in part)" * (counts != {1}) for key, counts in seeds.items() if 1 in counts]
    if not single:
        return ()
    return (f"One training seed: {'; '.join(single)}. The interval speaks about that policy, not about the method.",)


def unthrown(evidence: Evidence, used: Cells) -> tuple[str, ...]:
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
    listed = "; ".join(f"{name} in {k:,} of {n:,}" for name, k, n in fast)
    return (f"At the goal before any ball was thrown: {listed} successful flights.",)


def slow(evidence: Evidence, used: Cells) -> tuple[str, ...]:
    """One line that names the methods that mostly fail by being late, and how fast they fly."""
    late: dict[str, tuple[int, int, float]] = {}
    for key, where in used:
        rows = evidence.cells.get((key, where))
        if rows is not None and {"failure", "mean_speed"} <= set(rows):
            before, count, way = late.get(key, (0, 0, 0.0))
            here = int((rows["failure"].astype(str) == "late").sum())
            late[key] = before + here, count + len(rows), way + float(rows["mean_speed"].sum())
    slow_ones = [
        f"{evidence.names[key]} in {k:,} of {n:,}, at {way / n:.2f} m/s on average"
        for key, (k, n, way) in late.items()
        if k > LATE * n and way > STOPPED * n
    ]
    if not slow_ones:
        return ()
    return (f"Past the time limit without touching anything: {'; '.join(slow_ones)}{_needed(evidence, used)}.",)


def _needed(evidence: Evidence, used: Cells) -> str:
    """The speed that arriving takes, where the settings of these flights agree on it."""
    speeds = set()
    for _, where in used:
        settings = evidence.worlds.get(where.world.settings, {})
        field, start = settings.get("scenario.field", ""), settings.get("scenario.start", "")
        if (limit := settings.get("eval.time_limit")) and field and start:
            way = float(field.strip("[]").split(",")[1]) - float(start.strip("[]").split(",")[1])
            speeds.add(way / float(limit))
    return f" (arriving takes {speeds.pop():.2f} m/s)" if len(speeds) == 1 else ""
