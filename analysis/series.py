"""The numbers behind the figures, as tidy frames: sweeps, study trials, learning curves."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from analysis import methods, stats
from analysis.evidence import Evidence, Stamp, Where, World
from analysis.methods import Method
from analysis.records import Run
from analysis.rows import Store

if TYPE_CHECKING:
    import pandas as pd

Axis = Literal["columns", "balls"]

SWEEPS: Mapping[Axis, tuple[str, dict[str, int]]] = {
    "columns": ("static", {"balls": 0}),
    "balls": ("dynamic", {"columns": 0}),
}
"""Scenario of each sweep and the obstacles it has none of (paper, Sec. VI-A2)."""

CURVES = (
    ("train/collision_free", "Collision-free"),
    ("train/cfr", "CFR"),
    ("train/fm", "FM (m)"),
)
"""Logged metrics that are drawn, in order, with their axis labels."""

LOW = 0.5
"""CFR of a point below which it is told whether the method was only late."""

LEAST = 10
"""Episodes of a point; fewer are a recorded flight, no rate."""


def sweep_worlds(evidence: Evidence, axis: Axis) -> list[World]:
    """Worlds in which the sweep was flown, the paper's first."""
    scenario, none = SWEEPS[axis]
    flown = {where for _, where in _points(evidence, axis)}
    return list(dict.fromkeys(where.world for where in evidence.places(scenario, **none) if where in flown))


def sweep(evidence: Evidence, axis: Axis, world: World) -> "pd.DataFrame":
    """One row per method and number of obstacles: CFR and FM with intervals and counts; FM is NaN without success.

    Columns: method, obstacles, cfr, cfr_low, cfr_high, k, n, seeds, fm, fm_low, fm_high, fm_n.
    """
    import pandas as pd

    records = []
    for method, where in _points(evidence, axis):
        if where.world == world:
            rows = evidence.rows(method, where)
            assert rows is not None
            records.append({"method": evidence.names[method.key], "obstacles": getattr(where, axis), **point(rows)})
    return pd.DataFrame(records)


def late(evidence: Evidence, axis: Axis, world: World) -> tuple[str, ...]:
    """A sentence for each method whose CFR at a point is low because it is late, not because it touches anything.

    That is where CFR is below LOW and more than half of the failures are ``late``; such points are told together.
    """
    found: dict[str, list[tuple[int, int, int]]] = {}
    for method, where in _points(evidence, axis):
        rows = evidence.rows(method, where)
        if where.world == world and rows is not None and "failure" in rows:
            failed, late = int((~rows["cfr"].astype(bool)).sum()), int((rows["failure"].astype(str) == "late").sum())
            if len(rows) - failed < LOW * len(rows) and 2 * late > failed:
                found.setdefault(evidence.names[method.key], []).append((getattr(where, axis), late, len(rows)))
    return tuple(
        f"{name} at {_numbers([point for point, _, _ in points])} {axis if points[-1][0] != 1 else axis[:-1]}: "
        f"{sum(late for _, late, _ in points):,} of {sum(count for _, _, count in points):,} failed by being late."
        for name, points in found.items()
    )


def _numbers(points: list[int]) -> str:
    """1; 1 and 2; 1, 3 and 5."""
    *first, last = map(str, points)
    return f"{', '.join(first)} and {last}" if first else last


def sweep_cells(evidence: Evidence, axis: Axis, world: World) -> list[tuple[str, Where]]:
    """The cells that a sweep is made of, for its stamp."""
    return [(method.key, where) for method, where in _points(evidence, axis) if where.world == world]


def _points(evidence: Evidence, axis: Axis) -> list[tuple[Method, Where]]:
    """Cells that are points of a sweep, method by method, with a rising number of obstacles."""
    scenario, none = SWEEPS[axis]
    places = sorted(evidence.places(scenario, **none), key=lambda place: getattr(place, axis))
    return [
        (method, where)
        for method in _swept(evidence)
        for where in places
        if (rows := evidence.rows(method, where)) is not None and len(rows) >= LEAST
    ]


def study(store: Store, profile: str) -> tuple[Run, "pd.DataFrame"] | None:
    """The profile's latest study with a finished trial, and its finished trials (SR known) with Wilson intervals."""
    for run in reversed(store.runs):
        if run.kind != "search" or run.profile != profile or run.id not in store.studies:
            continue
        table = store.trials
        done = table[(table["study"] == run.id) & table["sr"].notna() & (table["state"].astype(str) == "done")].copy()
        if len(done):
            counts = done[["sr_k", "sr_n"]].astype(int).itertuples(index=False)
            done[["sr_low", "sr_high"]] = [stats.wilson(k, n) for k, n in counts]
            return run, done.sort_values(["sr", "trial"], ascending=[False, True]).reset_index(drop=True)
    return None


def study_stamp(run: Run, trials: "pd.DataFrame") -> Stamp:
    """Stamp of a study's figures."""
    steps = trials["steps"].dropna().unique().tolist() if "steps" in trials else []
    episodes = trials["sr_n"].dropna().unique().tolist()
    return Stamp(
        profile=run.profile,
        steps=tuple(sorted(int(value) for value in steps)),
        episodes=tuple(sorted(int(value) for value in episodes)),
        commits=(run.commit,),
        unit="trial",
    )


@dataclass(frozen=True)
class Curves:
    """Learning curves of a profile's trainings.

    ``table``: method, train_run, seed, steps, period and every curve of ``CURVES``; ``roles``: method name to
    ``ours``, ``encoder`` or ``curriculum`` (arms of an ablation) or ``other``.
    """

    table: "pd.DataFrame"
    roles: Mapping[str, str]
    store: Store
    profile: str

    def stamp(self, table: "pd.DataFrame") -> Stamp:
        """Stamp of a figure of some of the curves; steps are those reached, as not every training ends as planned."""
        runs = [self.store.run(str(id)) for id in table["train_run"].unique()]
        facts = [run.method for run in runs if run.method]
        return Stamp(
            profile=self.profile,
            steps=tuple(sorted({int(steps) for steps in table.groupby("train_run", observed=True)["steps"].max()})),
            seeds=tuple(sorted({fact.seed for fact in facts})),
            commits=tuple(dict.fromkeys(run.commit for run in runs)),
        )


def learning(store: Store, profile: str) -> Curves | None:
    """Learning curves of a profile's trainings; None when none of them logged any of ``CURVES``."""
    runs = [store.run(id) for id in store.logs if store.run(id).profile == profile]
    if not runs:
        return None
    import pandas as pd

    trained = {run.id: methods.identify(run.method, run, run) for run in runs if run.method}
    ordered = sorted(trained, key=lambda id: (methods.order(trained[id]), id))
    names = methods.labels({method.key: method for method in trained.values()}.values())
    frames, roles = [], {}
    for id in ordered:
        method, frame = trained[id], pd.DataFrame(store.logs[id])
        if any(key in frame and frame[key].notna().any() for key, _ in CURVES):
            frame = frame.reindex(columns=["steps", "period", *[key for key, _ in CURVES]])
            names_it = {"method": names[method.key], "train_run": id, "seed": method.facts.seed}
            frames.append(pd.concat([pd.DataFrame(names_it, index=frame.index), frame], axis=1))
            roles[names[method.key]] = _role(method)
    return Curves(pd.concat(frames, ignore_index=True), roles, store, profile) if frames else None


def _role(method: Method) -> str:
    if method.role != "arm":
        return method.role
    return "curriculum" if method.facts.encoder == "attention" else "encoder"


def _swept(evidence: Evidence) -> list[Method]:
    return list(evidence.shown)


def point(rows: "pd.DataFrame") -> dict[str, float]:
    """CFR and FM of some episodes with intervals and counts, as columns of a figure's data."""
    seeds = rows["train_seed"].to_numpy()
    ok = rows["cfr"].to_numpy(bool)
    cfr = stats.rate(ok, seeds)
    fm = stats.mean(rows["fm"].to_numpy(float)[ok], seeds[ok])
    point = {"cfr": cfr.value, "cfr_low": cfr.low, "cfr_high": cfr.high, "k": cfr.k, "n": cfr.n, "seeds": cfr.seeds}
    value, low, high, n = (fm.value, fm.low, fm.high, fm.n) if fm else (float("nan"),) * 3 + (0,)
    return point | {"fm": value, "fm_low": low, "fm_high": high, "fm_n": n}
