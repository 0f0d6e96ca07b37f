"""What counts as success, in words and cells: the corridor, SR's thresholds, parity with MuJoCo."""

import pandas as pd
import pytest

from analysis.data import evidence, rows
from analysis.tables import ablations, goal_lines, main
from analysis.tables.table import NOTHING, success_cell
from tests.analysis.synthetic import Made, episodes

EVAL = {
    "formation_threshold": 0.278,
    "speed_threshold": 0.5,
    "height_threshold": 0.1,
    "strict_radius": 0.21,
    "action_threshold": 0.01,
    "time_limit": 20.0,
}


@pytest.mark.parametrize(("outside", "said"), [(0, False), (1, False), (2, True), (40, True)])
def test_the_rate_without_the_corridor_is_said_where_it_differs_by_more_than_a_point(outside: int, said: bool) -> None:
    frame = episodes(100, 0.0).assign(cfr=[True] * 50 + [False] * 50, train_seed=0)
    frame = frame.assign(cfr_any_path=frame["cfr"] | (frame["scenario_id"] >= 100 - outside))
    details = success_cell(frame).details
    assert any("outside too" in line for line in details) is said
    if said:
        assert details[-1] == f"{(50 + outside) / 100:.3f} outside too"


def test_thresholds_stand_in_every_caption_that_shows_an_sr(made: Made) -> None:
    config = {"scenario": {"hit_radius": 0.15}, "eval": EVAL}
    made.evaluation(made.policy(made.training(log=False)), episodes(20, 0.9), config=config)
    found = evidence.gather(rows.load(made.root))
    for table in (main.tables(found)[0], ablations.encoder(found), ablations.curriculum(found)):
        assert "FM < 0.278 m" in table.caption and "throttle change < 0.01" in table.caption


def flown(made: Made, drone: dict[str, object], frame: pd.DataFrame) -> None:
    id = made.ids.setdefault("policy", made.ids.get("policy") or made.training(log=False))
    made.evaluation(made.policy(id), frame, config={"drone": drone, "eval": EVAL})


def test_mujoco_at_20_ms_is_a_sentence_and_at_2_ms_a_table(made: Made) -> None:
    fine, coarse = ({"control_period": 0.02, "substeps": count} for count in (10, 1))
    plain = episodes(30, 0.9)
    for settings, name in ((fine, "crazyflie"), (coarse, "crazyflie_release")):
        flown(made, settings, plain.assign(drone=name))
        flown(made, settings, plain.assign(drone=name, sim="mujoco", fm=plain["fm"] + 0.00003))
    found = evidence.gather(rows.load(made.root))
    tables = main.tables(found)
    assert "success is equal in 30 of 30, FM within 3e-05 m" in tables[0].notes[0]
    titles = [table.title for table in tables[1:]]
    assert len(titles) == 2
    assert any("independent check" in title and "mujoco world at 2 ms" in title for title in titles)
    assert not any("mujoco world at 20 ms" in title for title in titles)


def test_a_line_beyond_a_methods_destination_has_no_rate(made: Made) -> None:
    times = episodes(5, 1.0).assign(time_y34=15.0, time_y40=[None] * 5, first_contact_time=float("nan"))
    made.evaluation(made.baseline("rmader"), times.astype({"time_y40": float}), config={"eval": EVAL})
    table = goal_lines.table(evidence.gather(rows.load(made.root)))
    assert table is not None and [cell.text for cell in table.rows[0][1:3]] == ["1.000", NOTHING]
