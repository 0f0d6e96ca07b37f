"""The deployment table, the robustness figure and the claims, against rows made up with known answers."""

import pytest
from scipy.stats import binom

from analysis import ablations, claims, deployment, evidence, figures, plates, report, rows
from analysis.figures import Plate
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
    mixed = [line for line in ours if line["scenario"].text == deployment.SCENES["real_mixed"]]
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
    (plate,) = plates.robustness(seen)
    assert isinstance(plate, Plate) and len(plate.data) == 4
    drawn = [line.get_xdata() for line in plate.figure.axes[0].get_lines()]
    assert list(drawn[0]) == [0.0, 20.0, 80.0]  # ms
    assert figures.draw_robustness is not None


def verdicts(made: Made) -> list[str]:
    table = claims.table(evidence.gather(rows.load(made.root), baselines=["swarm_rl"]))
    assert len(table.rows) == 8
    assert all(row[3].command for row in table.rows if row[3].text == "not yet measured")
    return [row[3].text for row in table.rows]


def test_nothing_is_claimed_of_an_empty_store(made: Made) -> None:
    assert set(verdicts(made)) == {"not yet measured"}


def test_a_measured_failure_refutes_and_success_confirms(made: Made) -> None:
    policy = made.training(log=False)
    made.evaluation(made.policy(policy), episodes(200, 0.5, 0.2))
    assert verdicts(made)[0] == "not confirmed"  # CFR 0.5 is not 0.89
    better = made.training(log=False, steps=7_000_000)
    made.evaluation(made.policy(better), episodes(200, 0.92, 0.2))
    assert verdicts(made)[0] == "not yet measured"  # Swarm-RL was not flown
    made.evaluation(made.baseline("swarm_rl"), episodes(200, 0.85, 0.9, seed=1))
    assert verdicts(made)[0] == "confirmed"


def test_a_barely_trained_baseline_decides_nothing(made: Made) -> None:
    made.evaluation(made.policy(made.training(log=False)), episodes(200, 0.92, 0.2))
    learnt = made.baseline("swarm_rl") | {"steps": 20_000_000, "published_steps": 1_000_000_000}
    made.evaluation(learnt, episodes(200, 0.01, 0.05, seed=1))
    table = claims.table(evidence.gather(rows.load(made.root), baselines=["swarm_rl"]))
    verdict = table.rows[0][3]
    assert (verdict.text, verdict.details) == ("not yet measured", ("Swarm-RL: 2% of its published training",))
    assert verdict.command == "formctl train experiment=swarm_rl train.steps=1000000000"


def test_real_flight_is_judged_by_the_policy_trained_for_it(made: Made) -> None:
    real = {"experiment": "sim_to_real", "curriculum": "none", "scenario": "real_mixed"}
    for success, changed in ((0.3, {}), (0.9, real)):
        policy = made.policy(made.training(log=False, **changed))
        for number, scenario in enumerate(deployment.SCENES):
            flights = episodes(100, success, scenario=scenario, columns=2, balls=1, seed=number).assign(deploy="mocap")
            made.evaluation(policy, flights, config={"scenario": {"hit_radius": 0.15}, "deploy": DEPLOY})
    seen = evidence.gather(rows.load(made.root))
    assert [method.facts.experiment for method in seen.expected] == [""] and len(seen.shown) == 2
    parts = claims.transfer(seen)[1:]
    assert [part.holds for part in parts] == [True] * 3
    assert all("for real flights: 7 to 10 of ten, paper " in part.seen for part in parts), parts


def test_an_arm_of_another_recipe_is_none(made: Made) -> None:
    """Another learner is not shown among the arms; another budget is, and nothing is concluded from it."""
    made.evaluation(made.policy(made.training(log=False)), episodes(200, 0.9, 0.2))
    for changed in ({"algo": "shac"}, {"steps": 1_000_000}):
        policy = made.training(log=False, curriculum="none", **changed)
        made.evaluation(made.policy(policy), episodes(200, 0.99, 0.1, seed=3))
    seen = evidence.gather(rows.load(made.root))
    assert claims.table(seen).rows[4][3].text == "not yet measured"
    arms = [row for row in ablations.curriculum(seen).rows if row[0].text == "w/o CL" and not row[6].missing]
    assert len(arms) == 1


def test_everything_measured_is_judged(full: evidence.Evidence, page: report.Report) -> None:
    table = claims.table(full)
    judged = {row[0].text: row[3].text for row in table.rows}
    assert judged["2"] == "confirmed" and judged["7"] == "not yet measured"
    assert "CFR" in table.rows[1][2].text
    assert [section.key for section in page.sections][-2:] == ["deployment", "claims"]
