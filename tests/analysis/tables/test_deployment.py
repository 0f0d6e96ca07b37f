"""The deployment table and the robustness figure, against rows made up with known answers."""

import pytest
from scipy.stats import binom

from analysis.data import evidence, rows
from analysis.data.published import REAL_SCENES
from analysis.figures import report_figures
from analysis.figures.style import ReportFigure
from analysis.tables import deployment
from tests.analysis.synthetic import Made, episodes

DEPLOY = {"name": "mocap", "latency": 0.02, "mass": [0.97, 1.03]}


def deployed(made: Made, name: str, count: int, success: float, **changed: object) -> None:
    """An evaluation of a new training's policy in real_mixed under the deployment of that name."""
    flown = episodes(count, success, scenario="real_mixed", columns=2, balls=1).assign(deploy=name)
    settings = {"scenario": {"hit_radius": 0.15}, "eval": {"strict_radius": 0.21}, "deploy": DEPLOY | changed}
    known = made.ids.setdefault("policy", "") or made.training(log=False)
    made.ids["policy"] = known
    made.evaluation(made.policy(known), flown, config=settings)


def test_ten_flights_and_what_ten_could_show() -> None:
    flown = episodes(1000, 0.7, scenario="real_mixed")
    seen = deployment.summary(flown)
    assert (seen.ten, seen.tried, seen.rate.n) == (int(flown["cfr"][:10].sum()), 10, 1000)
    law = binom(10, flown["cfr"].mean())  # a thousand flights leave hardly any doubt about the rate
    assert (seen.least, seen.most) == (law.ppf(0.025), law.ppf(0.975))
    assert seen.fm == pytest.approx(flown.loc[flown["cfr"], "fm"].mean())
    few = deployment.summary(flown[:4])
    assert few.tried == 4 and few.most - few.least > seen.most - seen.least


def test_the_table_keeps_disturbed_and_undisturbed_apart(made: Made) -> None:
    deployed(made, "mocap", 40, 0.5)
    plain = episodes(40, 0.9, scenario="real_mixed", columns=2, balls=1)
    made.evaluation(made.policy(made.ids["policy"]), plain)
    deployed(made, "mocap latency=0.08", 40, 0.1, latency=0.08)
    table = deployment.table(evidence.gather(rows.load(made.root)))
    keys = [column.key for column in table.columns]
    ours = [dict(zip(keys, line, strict=True)) for line in table.rows if line[1].text == "Ours, MAPPO"]
    mixed = [line for line in ours if line["scenario"].text == REAL_SCENES["real_mixed"]]
    assert ["deployment mocap" in line["world"].text for line in mixed] == [True, False]
    assert mixed[1]["cfr"].value == plain["cfr"].mean() and mixed[1]["world"].text.endswith("undisturbed")
    assert mixed[0]["cfr"].value != mixed[1]["cfr"].value


def test_what_all_worlds_of_the_table_share_is_said_once(made: Made) -> None:
    deployed(made, "mocap", 40, 0.5)
    still = episodes(40, 0.9, scenario="real_static", columns=2, balls=0)
    made.evaluation(made.policy(made.ids["policy"]), still)
    seen = evidence.gather(rows.load(made.root))
    table = deployment.table(seen)
    keys = [column.key for column in table.columns]
    worlds = [dict(zip(keys, line, strict=True))["world"].text for line in table.rows if line[1].text == "Ours, MAPPO"]
    assert table.caption.endswith("All flights here: crazyflie, balls aimed at a drone.")
    assert worlds[0] == "torch world, undisturbed" and worlds[-1] == "torch world, deployment mocap"


def test_points_of_a_curve(made: Made) -> None:
    for latency, success in ((0.0, 0.9), (0.02, 0.8), (0.08, 0.2)):
        deployed(made, f"mocap latency={latency:g}", 50, success, latency=latency)
    deployed(made, "mocap mass=1.1", 50, 0.5, mass=[1.1, 1.1])
    seen = evidence.gather(rows.load(made.root))
    points = deployment.curves(seen)
    assert list(points["axis"]) == ["latency"] * 3 + ["mass"]
    assert list(points["value"]) == [0.0, 0.02, 0.08, 1.1]
    assert points["cfr"][0] > points["cfr"][2] and set(points["n"]) == {50}
    (plate,) = report_figures.robustness(seen)
    assert isinstance(plate, ReportFigure) and len(plate.data) == 4
    drawn = [line.get_xdata() for line in plate.figure.axes[0].get_lines()]
    assert list(drawn[0]) == [0.0, 20.0, 80.0]  # ms
