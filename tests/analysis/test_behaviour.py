"""Behaviour pictures in the report: drawn from recordings, or the command that makes them."""

import dataclasses
import json
from pathlib import Path
from typing import Any

from analysis import behaviour, evidence, figures, rows
from analysis.plates import Gap
from analysis.recordings import Recording
from analysis.recordings.mcap_writer import write
from tests.analysis.synthetic import Made, episodes
from tests.analysis.test_recordings import scene, trace


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


def drawn(root: Path) -> "tuple[list[behaviour.Drawn], tuple[str, ...]]":
    found = evidence.gather(rows.load(root))
    return behaviour.pictures(found), behaviour.unrecorded(found)


def test_both_scenes_with_every_method_that_flew_the_same_episode(made: Made) -> None:
    for name in ("rmader", "swarm_formation"):
        flown(made, name, "fixed4")
    flown(made, "rmader", "dynamic")
    flown(made, "swarm_formation", "dynamic", number=8)  # another episode cannot stand beside it
    (columns, balls), missing = drawn(made.root)
    assert isinstance(columns, figures.Plate) and isinstance(balls, figures.Plate)
    assert set(columns.data["method"]) == {"R-MADER", "Swarm-Formation"}
    assert balls.data["method"].nunique() == 1 and len(missing) == 1
    assert (
        missing[0].startswith("formctl eval --baseline ")
        and "scenario=dynamic --record first=1 --episodes 1 " in missing[0]
    )
    assert "profile laptop" in columns.stamp and columns.key == "behaviour_fixed4" and columns.double


def test_the_stamp_of_a_picture_speaks_of_learnt_baselines(made: Made) -> None:
    flown(made, "swarm_rl", "dynamic", facts={"steps": 16_121_856})
    (_, balls), _ = drawn(made.root)
    assert isinstance(balls, figures.Plate)
    assert balls.stamp.startswith("profile laptop · trained 16.1 M steps · one seed (0) · ")


def test_who_is_missing_flies_the_bank_that_the_others_flew(made: Made) -> None:
    bank = {"sha256": scene().bank, "seed": 1, "episodes": 1000}  # the first of another number is not the same episode
    for scenario in behaviour.SCENES:
        flown(made, "straight_line", scenario, bank=bank)
    made.evaluation(made.baseline("rmader"), episodes(20, 0.5))
    _, missing = drawn(made.root)
    assert [command.partition(" profile=")[0].split()[-1] for command in missing] == ["1000"] * 2


def test_neither_a_sanity_agent_nor_a_second_set_is_missing(made: Made) -> None:
    for scenario in behaviour.SCENES:
        flown(made, "rmader_fair", scenario)
    for name in ("hover", "rmader", "swarm_formation"):
        made.evaluation(made.baseline(name), episodes(20, 0.5))
    _, missing = drawn(made.root)
    assert [command.split()[3] for command in missing] == ["swarm_formation"] * 2


def test_the_episode_that_most_methods_flew_is_shown(made: Made) -> None:
    for name, number in (("straight_line", 8), ("straight_line", 7), ("hover", 7), ("hover", 9)):
        flown(made, name, "dynamic", number)
    (_, balls), _ = drawn(made.root)
    assert isinstance(balls, figures.Plate)
    assert set(balls.data["method"]) == {"Straight line", "Hover"} and "Episode 7 " in balls.caption


def test_a_recording_stays_when_its_episode_is_flown_again_without_one(made: Made) -> None:
    flown(made, "hover", "dynamic")
    made.evaluation(
        made.baseline("hover"), episodes(400, 0.5, scenario="dynamic", columns=2, balls=1), scenario="dynamic"
    )
    (_, balls), missing = drawn(made.root)
    assert isinstance(balls, figures.Plate) and missing == ()
    assert "1 episode per method" in balls.stamp


def test_without_a_readable_recording_the_command_stands_there(made: Made) -> None:
    flown(made, "straight_line", "fixed4", damaged=True)
    (columns, balls), missing = drawn(made.root)
    assert isinstance(columns, Gap) and isinstance(balls, Gap) and missing == ()
    assert columns.commands == (
        "formctl eval --baseline straight_line scenario=fixed4 --record first=1 --episodes 1 "
        f"profile=laptop runs={made.root}",
    )
    assert json.loads(next(made.root.glob("eval/*/*/run.json")).read_text())["recordings"]
