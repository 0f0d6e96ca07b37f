"""The report's figures from one profile's evidence, each with its data, caption and stamp, or what to type for it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Union

from analysis import baselines, commands, deployment, diversity, series
from analysis.evidence import Evidence, world_label
from analysis.records import Run
from analysis.tables import is_headline, seed_notes, unthrown_notes

if TYPE_CHECKING:  # matplotlib takes a second to import: only when there is something to draw
    import pandas as pd

    from analysis.figures import Look, Plate


@dataclass(frozen=True)
class Gap:
    """A figure that cannot be drawn yet, and what to type for it."""

    key: str
    title: str
    commands: tuple[str, ...]


Drawn = Union["Plate", Gap]

_AXES = {
    "columns": ("Columns sweep", "Number of columns (no balls)"),
    "balls": ("Balls sweep", "Number of balls (no columns)"),
}


def sweeps(evidence: Evidence, axis: series.Axis) -> list[Drawn]:
    """CFR and FM against the number of obstacles: a figure for every world flown, the paper's first."""
    title, label = _AXES[axis]
    worlds = series.sweep_worlds(evidence, axis)
    drawn: list[Drawn] = []
    if not any(is_headline(world._replace(ball_aim=world.ball_aim or "drone")) for world in worlds):
        drawn.append(Gap(f"sweep_{axis}", title, _sweep_commands(evidence, axis)))
    for number, world in enumerate(worlds, start=1):
        from analysis import figures

        points, flown = series.sweep(evidence, axis, world), series.sweep_cells(evidence, axis, world)
        stamp = str(evidence.stamp(flown))
        figure = figures.draw_sweep(points, _looks(evidence), label, stamp)
        where = world_label(evidence, world, worlds[0])
        known = f"{where[0].upper()}{where[1:]}. Bands: 95 % intervals."
        late = series.late(evidence, axis, world)
        over = "FM over successful episodes; no point without any."
        caption = " ".join((known, over, *late, *unthrown_notes(evidence, flown), *seed_notes(evidence, flown)))
        key = f"sweep_{axis}" if number == 1 and not drawn else f"sweep_{axis}_{number}"
        drawn.append(figures.Plate(key, title, caption, figure, points, stamp))
    return drawn


def unswept(evidence: Evidence, axis: series.Axis) -> tuple[str, ...]:
    """Commands for the compared methods that the sweep's first world does not show at every point of the paper's."""
    worlds = series.sweep_worlds(evidence, axis)
    if not worlds:
        return ()
    flown = series.sweep_cells(evidence, axis, worlds[0])
    wanted = set(commands.COLUMNS if axis == "columns" else commands.BALLS)
    return tuple(
        commands.fly(evidence, method, _grid(axis))
        for method in evidence.compared
        if not wanted <= {getattr(where, axis) for key, where in flown if key == method.key}
    )


def weights(evidence: Evidence) -> list[Drawn]:
    """Stage 1: satisfaction rate over the weight simplex, the ranked trials, and the styles of those that kept rows."""
    found = series.study(evidence.store, evidence.profile)
    if found is None:
        return [Gap("simplex", "Satisfaction rate over the weight simplex", (commands.search(evidence),))]
    from analysis import figures

    run, trials = found
    stamp = str(series.study_stamp(run, trials))
    simplex = figures.draw_simplex(trials, stamp)
    ranking = figures.draw_ranking(trials, stamp)
    seen = f"Study {run.name}, {len(trials)} trials; the darker, the higher."
    return [
        figures.Plate(
            "simplex",
            "Satisfaction rate over the weight simplex",
            f"{seen} (a) The tetrahedron of all weights. (b–e) The same trials in four slices by their action weight; "
            "place in a triangle: the other three weights as shares of the rest. Ring: the best trial.",
            simplex,
            trials,
            stamp,
            double=True,
        ),
        figures.Plate("ranking", "Trials by satisfaction rate", "Bars: Wilson 95 % intervals.", ranking, trials, stamp),
        *_diversity(run, trials, stamp),
    ]


def _diversity(run: Run, trials: "pd.DataFrame", stamp: str) -> "list[Plate]":
    from analysis import figures

    styles = diversity.table(run, trials)
    if not len(styles):
        return []
    figure = figures.draw_diversity(styles, {q.column: q.label for q in diversity.QUANTITIES}, stamp)
    caption = "How the trials fly, best satisfaction rate on top. Dots: means over episodes, bars: 95 % intervals."
    return [figures.Plate("diversity", "Styles of flying", caption, figure, styles, stamp, double=True)]


def robustness(evidence: Evidence) -> list[Drawn]:
    """CFR and FM against the disturbances of a deployment: a figure for every world flown."""
    title = "Robustness of a deployment"
    flown = deployment.curve_cells(evidence)
    if not flown:
        return [Gap("robustness", title, tuple(filter(None, [deployment.curve_command(evidence)])))]
    from analysis import figures

    points = deployment.curves(evidence)
    stamp = str(evidence.stamp(flown))
    drawn: list[Drawn] = []
    for number, (world, part) in enumerate(points.groupby("world", sort=True), start=1):
        figure = figures.draw_robustness(part, deployment.AXES, _looks(evidence), stamp)
        key = "robustness" if number == 1 else f"robustness_{number}"
        caption = f"{world}; one quantity varied at a time, the others as in that deployment. Bands: 95 % intervals."
        drawn.append(figures.Plate(key, title, caption, figure, part, stamp, double=part["axis"].nunique() > 1))
    return drawn


def learning(evidence: Evidence) -> list[Drawn]:
    """Learning curves: the full method and other policies, then the arms of each ablation beside it."""
    found = series.learning(evidence.store, evidence.profile)
    if found is None:
        return [Gap("learning", "Learning curves", (commands.train(evidence),))]
    from analysis import figures

    curves, roles = found.table, found.roles
    groups = {
        "learning": ("ours", "other"),
        "learning_encoder": ("ours", "encoder"),
        "learning_curriculum": ("ours", "curriculum"),
    }
    titles = {
        "learning": "Learning curves",
        "learning_encoder": "Learning curves of the encoder's arms",
        "learning_curriculum": "Learning curves of the curriculum's arms",
    }
    drawn: list[Drawn] = []
    for key, wanted in groups.items():
        chosen = curves[curves["method"].map(roles).isin(wanted)]
        if chosen.empty or (key != "learning" and set(chosen["method"].map(roles)) == {"ours"}):
            continue
        looks = figures.looks(list(dict.fromkeys(chosen["method"])))
        text = str(found.stamp(chosen))
        figure = figures.draw_learning(chosen, series.CURVES, looks, text)
        caption = (
            "Training episodes, with exploration noise; thin lines are seeds. They end earlier than evaluations "
            "(scenario.duration), so fewer teams get home in time."
        )
        if figures.period_starts(chosen):
            caption += " Names above: periods of the curriculum."
        drawn.append(figures.Plate(key, titles[key], caption, figure, chosen, text))
    return drawn


def _looks(evidence: Evidence) -> "dict[str, Look]":
    from analysis import figures

    first = {"ours": 0, "baseline": 1}  # who has a colour alone, while there are enough
    shown, names = sorted(evidence.shown, key=lambda method: first.get(method.role, 2)), evidence.names
    floor = [names[method.key] for method in shown if method.role == "sanity"]
    sets = {names[fair.key]: names[published.key] for published, fair in baselines.pairs(shown)}
    return figures.looks([names[method.key] for method in shown], floor, sets)


def _grid(axis: series.Axis) -> list[str]:
    return commands.columns_sweep() if axis == "columns" else commands.balls_sweep()


def _sweep_commands(evidence: Evidence, axis: series.Axis) -> tuple[str, ...]:
    """What fills an empty sweep: every method known, or the whole pipeline."""
    known = evidence.expected
    if not known:
        return (commands.everything(evidence),)
    return tuple(commands.fly(evidence, method, _grid(axis)) for method in known)
