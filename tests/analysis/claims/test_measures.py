"""Claims measured on rows made up with known answers."""

import json

import numpy as np
import pandas as pd
import pytest

from analysis.claims import claims, measures
from analysis.claims.measures import NotMeasured
from analysis.claims.verdicts import Outcome, outcome
from analysis.data import evidence, lookup, rows
from analysis.data.published import REAL_SCENES
from analysis.tables import ablations
from tests.analysis.synthetic import Made, episodes, trials

DEPLOY = {"name": "mocap", "latency": 0.02, "mass": [0.97, 1.03]}
REAL = {"experiment": "sim_to_real", "curriculum": "none", "scenario": "real_mixed"}


def exactly(satisfied: int, count: int, fm: float = 0.2, **place: object) -> pd.DataFrame:
    """The first ``satisfied`` of ``count`` episodes succeed in everything, the others hit a column."""
    frame = episodes(count, 1.0, fm, **place)  # type: ignore[arg-type]
    good = np.arange(count) < satisfied
    for flag in ("cfr", "sr", "ok_obstacle"):
        frame[flag] = good
    return frame.assign(ok_formation=True, ok_flight=True, ok_action=True)


def gathered(made: Made) -> evidence.Evidence:
    return evidence.gather(rows.load(made.root))


def outcomes(made: Made, claim: int) -> dict[str, Outcome]:
    """What came of a claim's checks, by what they check."""
    seen = gathered(made)
    return {check.what: outcome(seen, check) for check in claims.CHECKS if check.claim == claim}


def swept(made: Made, ours: dict[int, int], rival: tuple[int, int], fm: float = 0.1) -> dict[str, Outcome]:
    """Claim 2 of a policy with so many successes of 1,000 at 5 and 20 columns, and of a planner at 20."""
    policy = made.policy(made.training(log=False))
    flights = [
        exactly(k, 1000, fm * columns / 20, scenario="static", columns=columns, balls=0) for columns, k in ours.items()
    ]
    made.evaluation(policy, [episodes(100, 0.9), *flights])
    made.evaluation(made.baseline("rmader"), exactly(*rival, scenario="static", columns=20, balls=0))
    return outcomes(made, 2)


def test_a_planners_few_perfect_flights_are_not_better(made: Made) -> None:
    """25 of 25 beside 960 of 1000: of the 25 that both flew not one differs."""
    seen = swept(made, {5: 1000, 20: 960}, (25, 25))
    assert seen["CFR lost, 5 to 20 columns"].holds is True and seen["FM gained (m), 5 to 20 columns"].holds is True
    rival = seen["CFR at 20 columns"]
    assert rival.holds is None and not rival.lacking
    assert rival.seen[0].text == "Ours, MAPPO 960/1000, R-MADER 25/25; 25 shared episodes, p = 1.000"
    assert seen["CFR lost, 1 to 5 balls"].lacking == "Ours, MAPPO, 1 balls"


def test_no_baseline_is_better_where_ours_wins_on_shared_episodes(made: Made) -> None:
    assert swept(made, {5: 1000, 20: 960}, (10, 25))["CFR at 20 columns"].holds is True
    worse = swept(Made(made.root.parent / "other"), {5: 1000, 20: 500}, (1000, 1000))
    assert [worse[what].holds for what in ("CFR lost, 5 to 20 columns", "CFR at 20 columns")] == [False, False]


def test_fm_that_grows_over_a_sweep_refutes(made: Made) -> None:
    assert swept(made, {5: 1000, 20: 960}, (10, 25), fm=0.4)["FM gained (m), 5 to 20 columns"].holds is False


def test_a_barely_trained_baseline_decides_nothing(made: Made) -> None:
    learnt = made.baseline("swarm_rl") | {"steps": 20_000_000, "published_steps": 1_000_000_000}
    made.evaluation(learnt, [exactly(1, 1000, scenario="static", columns=20, balls=0), episodes(200, 0.01, 0.05)])
    (rival,) = swept(made, {5: 1000, 20: 960}, (10, 25))["CFR at 20 columns"].seen
    assert "R-MADER" in rival.text
    beside = outcomes(made, 1)["CFR beside Swarm-RL's"]
    assert beside.holds is None
    assert beside.lacking == "Swarm-RL: 2% of its published training, from 10% on it counts"


@pytest.mark.parametrize(("theirs", "holds"), [(950, True), (999, False)])
def test_swarm_rls_rate_is_similar_unless_the_test_says_better(made: Made, theirs: int, holds: bool) -> None:
    made.evaluation(made.policy(made.training(log=False)), exactly(947, 1000, 0.2))
    made.evaluation(made.baseline("swarm_rl"), exactly(theirs, 1000, 0.9))
    seen = outcomes(made, 1)
    assert seen["CFR beside Swarm-RL's"].holds is holds
    assert seen["FM, ratio"].holds is True and seen["CFR"].holds is True and seen["FM (m)"].holds is True


@pytest.mark.parametrize(
    ("count", "static", "few", "many", "holds"),
    [(1000, 0.9, 0.9, 0.6, True), (1000, 0.7, 0.9, 0.8, False), (30, 0.8, 0.9, 0.7, None)],
)
def test_what_swarm_rl_is_good_and_bad_at(
    made: Made, count: int, static: float, few: float, many: float, holds: bool | None
) -> None:
    scenes = [exactly(round(static * count), count, scenario="static", columns=10, balls=0)]
    for balls, share in ((1, few), (5, many)):
        scenes.append(exactly(round(share * count), count, scenario="dynamic", columns=0, balls=balls))
    made.evaluation(made.baseline("swarm_rl"), scenes)
    seen = outcomes(made, 3)
    assert [seen[what].holds for what in ("CFR, 10 columns", "CFR lost, 1 to 5 balls")] == [holds, holds]
    assert seen["FM (m) above ours"].lacking


def arms(made: Made, satisfied: dict[str, int], hits: int = 0, late: int = 0) -> dict[str, Outcome]:
    """Arms of the curriculum with so many successes of 1,000; ``none`` is hit by balls, ``dynamic`` late so often."""
    for name, k in satisfied.items():
        frame = exactly(k, 1000)
        if name == "none":
            frame["hit_ball"] = np.arange(1000) < hits
        if name == "three_period_dynamic":
            frame["ok_flight"] = np.arange(1000) >= late
        made.evaluation(made.policy(made.training(log=False, curriculum=name, name=name)), frame)
    return outcomes(made, 5)


ALL = {"three_period": 941, "none": 936, "two_period": 970, "three_period_dynamic": 900}


def test_arms_are_told_apart_on_shared_episodes_only(made: Made) -> None:
    seen = arms(made, ALL)["SR"]
    assert seen.holds is False  # one arm is ahead of ours
    assert [(figure.low, figure.high) for figure in seen.seen] == [(1, 1), (-1, -1), (-1, 1)]
    assert seen.seen[2].text == "Ours 941/1000, w/o CL 936/1000; 1000 shared episodes, p = 0.062"


@pytest.mark.parametrize(("hits", "found"), [(30, (1, 1)), (2, (-1, 1))])
def test_balls_are_judged_on_shared_episodes(made: Made, hits: int, found: tuple[int, int]) -> None:
    last = arms(made, ALL, hits=hits)["no ball hit"].seen[-1]
    assert (last.low, last.high) == found


@pytest.mark.parametrize(("late", "holds"), [(0, False), (300, True), (100, None)])
def test_late_is_more_than_slightly_late(made: Made, late: int, holds: bool | None) -> None:
    seen = arms(made, {"three_period": 941, "three_period_dynamic": 941}, late=late)
    assert seen["flight objective above that of balls first"].holds is holds
    assert seen["SR"].lacking == "2-period, mixed scene"


@pytest.mark.parametrize(("satisfied", "holds"), [(900, False), (600, True), (800, None)])
def test_a_variant_is_good_by_its_interval(made: Made, satisfied: int, holds: bool | None) -> None:
    for name, k in (("attention", 950), ("mlp", satisfied)):
        made.evaluation(made.policy(made.training(log=False, encoder=name, name=name)), exactly(k, 1000))
    seen = outcomes(made, 4)
    assert (seen["Ours"].holds, seen["MLP"].holds) == (True, holds)
    assert seen["w/o SA"].lacking == "w/o SA, mixed scene"


def study(made: Made, weights: list[list[float]], satisfied: list[int]) -> None:
    """Trials of 200 episodes each; the second was flown on fresh episodes too."""
    folder = made.run("search", "stage1")
    count = len(satisfied)
    fresh = {name: [None, value, *[None] * (count - 2)] for name, value in (("sr_fresh_k", 180), ("sr_fresh_n", 200))}
    table = trials(count).assign(sr_k=satisfied, sr=np.array(satisfied) / 200)
    table = table.assign(**{name: pd.array(values, "Int64") for name, values in fresh.items()})
    table[list(rows.WEIGHTS)] = weights
    table.to_parquet(folder / "trials.parquet", index=False)


SPREAD = [[0.1, 0.2, 0.3, 0.4], [0.25, 0.25, 0.3, 0.2], [0.4, 0.3, 0.2, 0.1]]


def test_only_trials_that_weigh_every_objective_make_the_rates_vary(made: Made) -> None:
    """The one trial that fails gives obstacles no weight: without it nothing varies."""
    study(made, [*SPREAD, [0.5, 0.2, 0.01, 0.29]], [188, 190, 186, 0])
    seen = outcomes(made, 6)
    assert seen["one SR for all (chi-squared p)"].holds is False and seen["range of SR"].holds is False
    assert seen["range of SR"].seen[0].text == "SR 0.930 to 0.950 over 3 trials"


def test_rates_that_vary_are_told_from_one_rate(made: Made) -> None:
    study(made, SPREAD, [60, 190, 120])
    seen = outcomes(made, 6)
    assert seen["one SR for all (chi-squared p)"].holds is True and seen["range of SR"].holds is True


def weighted(made: Made, weights: list[float], satisfied: int) -> None:
    id = made.training(log=False)
    folder = next(made.root.glob(f"train/*/{id}"))
    record = json.loads((folder / "run.json").read_text())
    record["method"]["weights"] = weights
    (folder / "run.json").write_text(json.dumps(record))
    made.evaluation(made.policy(id), exactly(satisfied, 1000))


def test_weights_transfer_only_where_a_policy_was_trained_with_them(made: Made) -> None:
    study(made, SPREAD, [150, 190, 160])
    weighted(made, [0.25, 0.25, 0.25, 0.25], 990)
    assert outcomes(made, 8)["SR lost from stage 1 to 2"].lacking
    weighted(made, [0.4, 0.3, 0.2, 0.1], 900)
    seen = outcomes(made, 8)["SR lost from stage 1 to 2"]
    assert seen.holds is True
    assert seen.seen[0].text == (
        "SR of trial 2's weights: 0.800 (160/200) in stage 1, 0.900 (900/1000) in the mixed scene"
    )


@pytest.mark.parametrize(("satisfied", "holds"), [(900, True), (700, False), (800, None)])
def test_the_winner_is_held_to_its_fresh_rate(made: Made, satisfied: int, holds: bool | None) -> None:
    study(made, SPREAD, [150, 190, 160])
    weighted(made, [0.25, 0.25, 0.3, 0.2], satisfied)
    seen = outcomes(made, 8)["SR lost from stage 1 to 2"]
    assert seen.seen[0].text.startswith("SR of trial 1's weights: 0.900 (180/200) in stage 1")
    assert seen.holds is holds


def deployed(
    made: Made, success: float, smooth: bool, deploy: str = "mocap", sim: str = "mujoco", **how: object
) -> str:
    """A training's flights in the deployment scenes, all smooth or none."""
    id = str(how.pop("of", "")) or made.training(log=False, **how)
    for number, scenario in enumerate(REAL_SCENES):
        flights = episodes(100, success, scenario=scenario, columns=2, balls=1, seed=number, sim=sim)
        settings = {"scenario": {"hit_radius": 0.15}, "deploy": DEPLOY}
        made.evaluation(made.policy(id), flights.assign(deploy=deploy, ok_action=smooth), config=settings)
    return id


@pytest.mark.parametrize(("success", "smooth"), [(0.9, True), (0.9, False), (0.1, True), (0.1, False)])
def test_real_flight_is_judged_by_the_policy_trained_for_it(made: Made, success: float, smooth: bool) -> None:
    deployed(made, 0.5, not smooth)  # trained for the mixed scene: nothing is said of it
    deployed(made, success, smooth, **REAL)
    seen = outcomes(made, 8)
    for scenario in REAL_SCENES:
        assert seen[f"flights, {scenario}"].holds is (success == 0.9)
        assert seen[f"smoothness, {scenario}"].holds is smooth
        assert "sim to real" in seen[f"flights, {scenario}"].seen[0].text


def test_a_policy_of_the_mixed_scene_says_nothing_of_real_flights(made: Made) -> None:
    deployed(made, 0.95, True)
    with pytest.raises(NotMeasured, match="a policy trained for them"):
        measures.real_flights("real_mixed", "successes")(gathered(made))


def test_deployed_flights_are_those_in_mujoco_over_motion_capture(made: Made) -> None:
    id = deployed(made, 0.2, True, deploy="harsh", sim="torch", **REAL)
    for deploy, sim, success in (("mocap", "torch", 0.3), ("harsh", "mujoco", 0.4), ("mocap", "mujoco", 0.9)):
        deployed(made, success, True, deploy, sim, of=id)
        seen = gathered(made)
        _, flights = lookup.deployed(seen, "real_mixed", seen.methods.values()) or pytest.fail("no flights")
        assert (set(flights["deploy"]), set(flights["sim"])) == ({deploy}, {sim})


def test_an_arm_of_another_recipe_is_none(made: Made) -> None:
    """Another learner is not shown among the arms; another budget is, and nothing is concluded from it."""
    made.evaluation(made.policy(made.training(log=False)), episodes(200, 0.9, 0.2))
    for changed in ({"algo": "shac"}, {"steps": 1_000_000}):
        policy = made.training(log=False, curriculum="none", **changed)
        made.evaluation(made.policy(policy), episodes(200, 0.99, 0.1, seed=3))
    seen = gathered(made)
    assert outcomes(made, 5)["SR"].lacking
    arms = [row for row in ablations.curriculum(seen).rows if row[0].text == "w/o CL" and not row[6].missing]
    assert len(arms) == 1
