"""The report's figures from one profile's evidence, each with its data, caption and stamp, or the gap it leaves."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import pandas as pd

from analysis.data import lookup, recorded
from analysis.data.evidence import Evidence, world_label
from analysis.data.published import Axis
from analysis.data.runs import Run
from analysis.figures import series, style
from analysis.figures.behaviour import behaviour_data, draw_behaviour
from analysis.figures.diversity import draw_diversity
from analysis.figures.learning import draw_learning
from analysis.figures.robustness import draw_robustness
from analysis.figures.simplex import draw_ranking, draw_simplex
from analysis.figures.style import LineStyle, ReportFigure
from analysis.figures.sweep import draw_sweep
from analysis.recordings import Scene, merge
from analysis.stats import diversity
from analysis.tables import deployment
from analysis.tables.notes import notes, one_seed
from envs.vocabulary import satisfaction


@dataclass(frozen=True)
class MissingFigure:
    """A figure that cannot be drawn yet: nothing that it shows was measured."""

    key: str
    title: str


Drawn: TypeAlias = ReportFigure | MissingFigure

_SWEEPS: dict[Axis, tuple[str, str]] = {
    "columns": ("Columns sweep", "Number of columns (no balls)"),
    "balls": ("Balls sweep", "Number of balls (no columns)"),
}

_SCENES = {"fixed4": "Behaviour among columns", "dynamic": "Behaviour under thrown balls"}
"""The scenes of the paper's behaviour pictures (Sec. VI-A3): four columns that always stand the same, and balls."""

_LEARNING = {
    "learning": ("Learning curves", ("ours", "other")),
    "learning_encoder": ("Learning curves of the encoder's arms", ("ours", "encoder")),
    "learning_curriculum": ("Learning curves of the curriculum's arms", ("ours", "curriculum")),
}


def sweeps(evidence: Evidence, axis: Axis) -> list[Drawn]:
    """CFR and FM against the number of obstacles: a figure for every world flown, the paper's first."""
    title, label = _SWEEPS[axis]
    worlds = lookup.sweep_worlds(evidence, axis, series.LEAST)
    drawn: list[Drawn] = []
    if not any(world.standard for world in worlds):
        drawn.append(MissingFigure(f"sweep_{axis}", title))
    for number, world in enumerate(worlds, start=1):
        points, flown = series.sweep(evidence, axis, world), series.sweep_cells(evidence, axis, world)
        stamp = str(evidence.stamp(flown))
        figure = draw_sweep(points, line_styles(evidence), label, stamp)
        where = world_label(evidence, world, worlds[0])
        caption = " ".join(
            (
                f"{where[0].upper()}{where[1:]}. Bands: 95 % intervals; markers are moved apart sideways.",
                "FM over successful episodes; no point without any.",
                *notes(evidence, flown),
            )
        )
        key = f"sweep_{axis}" if number == 1 and not drawn else f"sweep_{axis}_{number}"
        drawn.append(ReportFigure(key, title, caption, figure, points, stamp))
    return drawn


def weights(evidence: Evidence) -> list[Drawn]:
    """Stage 1: satisfaction rate over the weight simplex, the ranked trials, and the styles of those that kept rows."""
    study = lookup.study(evidence)
    if study is None:
        return [MissingFigure("simplex", "Satisfaction rate over the weight simplex")]
    run, trials = study[0], diversity.with_intervals(study[1])
    stamp = str(series.study_stamp(run, trials))
    places = (
        f"Study {run.name}, {len(trials)} trials; the darker, the higher. (a) The tetrahedron of all weights. (b–e) "
        "The same trials in four slices by their action weight; place in a triangle: the other three weights as shares "
        f"of the rest. Ring: the best trial. {thresholds(run)}"
    )
    title = "Satisfaction rate over the weight simplex"
    bars = f"Bars: Wilson 95 % intervals. {thresholds(run)}"
    ranking = draw_ranking(trials, stamp)
    return [
        ReportFigure("simplex", title, places.strip(), draw_simplex(trials, stamp), trials, stamp, double=True),
        ReportFigure("ranking", "Trials by satisfaction rate", bars.strip(), ranking, trials, stamp),
        *_styles_of_flying(run, trials, stamp),
    ]


def thresholds(run: Run) -> str:
    """What counts in a study's SR, in words; empty where its settings do not tell."""
    evaluation = run.config.get("eval") or (run.config.get("search") or {}).get("eval") or {}
    return f"{satisfaction(evaluation)}." if "speed_threshold" in evaluation else ""


def _styles_of_flying(run: Run, trials: pd.DataFrame, stamp: str) -> list[ReportFigure]:
    styles = diversity.table(run, trials)
    if not len(styles):
        return []
    figure = draw_diversity(styles, {q.column: q.label for q in diversity.QUANTITIES}, stamp)
    caption = "How the trials fly, best satisfaction rate on top. Dots: means over episodes, bars: 95 % intervals."
    return [ReportFigure("diversity", "Styles of flying", caption, figure, styles, stamp, double=True)]


def robustness(evidence: Evidence) -> list[Drawn]:
    """CFR and FM against the disturbances of a deployment: a figure for every world flown."""
    title = "Robustness of a deployment"
    flown = deployment.curve_cells(evidence)
    if not flown:
        return [MissingFigure("robustness", title)]
    points = deployment.curves(evidence)
    stamp = str(evidence.stamp(flown))
    drawn: list[Drawn] = []
    for number, (world, part) in enumerate(points.groupby("world", sort=True), start=1):
        axes = {axis: deployment.AXES.get(str(axis), (str(axis), 1.0)) for axis in part["axis"].unique()}
        figure = draw_robustness(part, axes, line_styles(evidence), stamp)
        key = "robustness" if number == 1 else f"robustness_{number}"
        caption = f"{world}; one quantity varied at a time, the others as in that deployment. Bands: 95 % intervals."
        below = " ".join((caption, *one_seed(evidence, flown)))
        drawn.append(ReportFigure(key, title, below, figure, part, stamp, double=part["axis"].nunique() > 1))
    return drawn


def learning(evidence: Evidence) -> list[Drawn]:
    """Learning curves: the full method and other policies, then the arms of each ablation beside it."""
    found = series.learning(evidence.store, evidence.profile)
    if found is None:
        return [MissingFigure("learning", _LEARNING["learning"][0])]
    role = found.table["method"].map(found.roles)
    drawn: list[Drawn] = []
    for key, (title, wanted) in _LEARNING.items():
        chosen = found.table[role.isin(wanted)]
        if chosen.empty or (key != "learning" and set(chosen["method"].map(found.roles)) == {"ours"}):
            continue
        text = str(found.stamp(chosen))
        names = style.line_styles(list(dict.fromkeys(chosen["method"])))
        figure = draw_learning(chosen, series.CURVES, names, text)
        caption = (
            "Training episodes, with exploration noise; thin lines are seeds, dots the beginnings of the curriculum's "
            "periods. Every learner has its own axis of steps. Training episodes end earlier than evaluations "
            "(scenario.duration), so fewer teams get home in time."
        )
        wide = chosen["learner"].nunique() > 1
        drawn.append(ReportFigure(key, title, caption, figure, chosen, text, double=wide))
    return drawn


def behaviour(evidence: Evidence) -> list[Drawn]:
    """Every method's recorded flight in the same episode, a figure for each of the paper's two scenes."""
    return [_behaviour(evidence, scenario, title) for scenario, title in _SCENES.items()]


def _behaviour(evidence: Evidence, scenario: str, title: str) -> Drawn:
    flights = list(recorded.same_episode(evidence, scenario))
    if not flights:
        return MissingFigure(f"behaviour_{scenario}", title)
    recording = merge([flight.recording for flight in flights])
    names = [evidence.names[flight.method.key] for flight in flights]
    stamp = str(recorded.stamp(evidence, flights))
    scene = recording.scene
    parts = [
        f"Episode {scene.episode} of bank {scene.bank[:8]}, from above and in perspective; trails darken with time, a "
        "formation every 2 s."
    ]
    if (clear := lane_clearance(scene)) > scene.hit_radius:
        parts.append(f"Straight flight of the formation clears every column by {clear:.2f} m, centre to axis.")
    if any(trace.throws for trace in recording.traces):
        parts.append(
            "Balls are thrown at the drones of each method and so fly differently; beside each stands how far above or "
            "below the nearest drone it is where it comes closest."
        )
    figure = draw_behaviour(recording, stamp, names)
    data = behaviour_data(recording, names)
    return ReportFigure(f"behaviour_{scenario}", title, " ".join(parts), figure, data, stamp, double=True)


def lane_clearance(scene: Scene) -> float:
    """m between the straight lane of any drone and the axis of the column nearest to it; 0 without columns."""
    if not len(scene.columns):
        return 0.0
    course = scene.velocity[:2] / np.linalg.norm(scene.velocity[:2])
    across = np.array([course[1], -course[0]])
    return float(np.abs((scene.columns @ across)[:, None] - (scene.slots[:, :2] @ across)[None]).min())


def line_styles(evidence: Evidence) -> dict[str, LineStyle]:
    """One look for every method in all figures of a report; agents that avoid nothing are grey."""
    names = evidence.names
    floor = [names[method.key] for method in evidence.shown if method.role == "sanity"]
    return style.line_styles([names[method.key] for method in evidence.shown], floor)
