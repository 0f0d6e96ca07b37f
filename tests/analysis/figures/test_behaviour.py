"""Behaviour pictures in the report: drawn from recordings, or missing."""

import dataclasses
import json
from pathlib import Path
from typing import Any

from analysis.data import evidence, rows
from analysis.figures import report_figures
from analysis.figures.report_figures import Drawn, MissingFigure
from analysis.figures.style import ReportFigure
from analysis.recordings import Recording
from analysis.recordings.mcap_writer import write
from tests.analysis.recordings.test_recordings import scene, trace
from tests.analysis.synthetic import Made, episodes


def flown(made: Made, name: str, scenario: str, number: int = 7, damaged: bool = False, **record: Any) -> None:
    facts = record.pop("facts", {})
    """An evaluation of a baseline with one recorded episode beside its rows."""
    frame = episodes(20, 0.5, scenario=scenario, columns=2, balls=1)
    recorded = ["mcap/episode_7.mcap"]
    folder = made.evaluation(made.baseline(name) | facts, frame, scenario=scenario, recordings=recorded, **record)
    (folder / "mcap").mkdir()
    where = dataclasses.replace(scene(), scenario=scenario, episode=number)
    path = write(Recording(where, (trace(name, name == "hover", 3),), {}), folder / recorded[0])
    if damaged:
        path.write_bytes(path.read_bytes()[:1000])


def drawn(root: Path) -> list[Drawn]:
    return report_figures.behaviour(evidence.gather(rows.load(root)))


def test_both_scenes_with_every_method_that_flew_the_same_episode(made: Made) -> None:
    for name in ("rmader", "swarm_formation"):
        flown(made, name, "fixed4")
    flown(made, "rmader", "dynamic")
    flown(made, "swarm_formation", "dynamic", number=8)  # another episode cannot stand beside it
    columns, balls = drawn(made.root)
    assert isinstance(columns, ReportFigure) and isinstance(balls, ReportFigure)
    assert set(columns.data["method"]) == {"R-MADER", "Swarm-Formation"}
    assert balls.data["method"].nunique() == 1
    assert "profile laptop" in columns.stamp and columns.key == "behaviour_fixed4" and columns.double


def test_the_stamp_of_a_picture_speaks_of_learnt_baselines(made: Made) -> None:
    flown(made, "swarm_rl", "dynamic", facts={"steps": 16_121_856})
    _, balls = drawn(made.root)
    assert isinstance(balls, ReportFigure)
    assert balls.stamp.startswith("profile laptop · trained 16.1 M steps · one seed (0) · ")


def test_the_episode_that_most_methods_flew_is_shown(made: Made) -> None:
    for name, number in (("straight_line", 8), ("straight_line", 7), ("hover", 7), ("hover", 9)):
        flown(made, name, "dynamic", number)
    _, balls = drawn(made.root)
    assert isinstance(balls, ReportFigure)
    assert set(balls.data["method"]) == {"Straight line", "Hover"} and "Episode 7 " in balls.caption


def test_a_recording_stays_when_its_episode_is_flown_again_without_one(made: Made) -> None:
    flown(made, "hover", "dynamic")
    made.evaluation(
        made.baseline("hover"), episodes(400, 0.5, scenario="dynamic", columns=2, balls=1), scenario="dynamic"
    )
    _, balls = drawn(made.root)
    assert isinstance(balls, ReportFigure)
    assert "1 episode per method" in balls.stamp


def test_without_a_readable_recording_a_figure_is_missing(made: Made) -> None:
    flown(made, "straight_line", "fixed4", damaged=True)
    columns, balls = drawn(made.root)
    assert isinstance(columns, MissingFigure) and isinstance(balls, MissingFigure)
    assert json.loads(next(made.root.glob("eval/*/*/run.json")).read_text())["recordings"]
