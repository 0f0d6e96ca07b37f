"""The numbers behind the figures, as tidy frames: sweeps and learning curves."""

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from analysis.data import lookup, methods
from analysis.data.evidence import Evidence, Stamp, Where, World
from analysis.data.methods import Method
from analysis.data.published import Axis
from analysis.data.rows import Store
from analysis.data.runs import Run
from analysis.tables.deployment import point

CURVES = (
    ("train/collision_free", "Collision-free"),
    ("train/cfr", "CFR"),
    ("train/fm", "FM (m)"),
)
"""Logged metrics that are drawn, in order, with their axis labels."""

LEAST = 10
"""Episodes of a point; fewer are a recorded flight, no rate."""


def sweep(evidence: Evidence, axis: Axis, world: World) -> pd.DataFrame:
    """One row per method and number of obstacles: CFR and FM with intervals and counts; FM is NaN without success.

    Columns: method, obstacles, cfr, cfr_low, cfr_high, k, n, seeds, fm, fm_low, fm_high, fm_n.
    """
    records = [
        {"method": evidence.names[key], "obstacles": getattr(where, axis), **point(evidence.cells[key, where])}
        for key, where in sweep_cells(evidence, axis, world)
    ]
    return pd.DataFrame(records)


def sweep_cells(evidence: Evidence, axis: Axis, world: World) -> list[tuple[str, Where]]:
    """The cells that a sweep is made of, for its stamp."""
    cells = lookup.sweep_cells(evidence, axis, LEAST)
    return [(method.key, where) for method, where in cells if where.world == world]


def study_stamp(run: Run, trials: pd.DataFrame) -> Stamp:
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

    ``table``: method, learner, train_run, seed, steps, period and every curve of ``CURVES``; ``roles``: method name to
    ``ours``, ``encoder`` or ``curriculum`` (arms of an ablation) or ``other``.
    """

    table: pd.DataFrame
    roles: Mapping[str, str]
    store: Store
    profile: str

    def stamp(self, table: pd.DataFrame) -> Stamp:
        """Stamp of a figure of some of the curves; steps are those reached, as not every training ends as planned."""
        runs = [self.store.run(str(id)) for id in table["train_run"].unique()]
        reached = {int(steps) for steps in table.groupby("train_run", observed=True)["steps"].max()}
        return Stamp.of(self.profile, runs, steps=tuple(sorted(reached)))


def learning(store: Store, profile: str) -> Curves | None:
    """Learning curves of a profile's trainings; None when none of them logged any of ``CURVES``."""
    runs = [store.run(id) for id in store.logs if store.run(id).profile == profile]
    trained = {run.id: methods.identify(run.method, run, run, store.winners) for run in runs if run.method}
    names = methods.labels({method.key: method for method in trained.values()}.values())
    frames, roles = [], {}
    for id in sorted(trained, key=lambda id: (methods.order(trained[id]), id)):
        method, frame = trained[id], store.logs[id]
        if any(key in frame and frame[key].notna().any() for key, _ in CURVES):
            frame = frame.reindex(columns=["steps", "period", *[key for key, _ in CURVES]])
            known: dict[str, object] = {
                "method": names[method.key],
                "learner": method.facts.algo.upper() or method.facts.name,
            }
            known |= {"train_run": id, "seed": method.facts.seed}
            frames.append(pd.concat([pd.DataFrame(known, index=frame.index), frame], axis=1))
            roles[names[method.key]] = _role(method)
    return Curves(pd.concat(frames, ignore_index=True), roles, store, profile) if frames else None


def _role(method: Method) -> str:
    if method.role != "arm":
        return "ours" if method.role == "ours" or method.recipe else method.role
    return "curriculum" if method.facts.encoder == "attention" else "encoder"
