"""The claims and what decides them, against rows made up with known answers."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest

from analysis import ablations, claims, deployment, evidence, flown, report, rows, stats, transfer, verdicts
from tests.analysis.synthetic import Made, episodes, trials

DEPLOY = {"name": "mocap", "latency": 0.02, "mass": [0.97, 1.03]}


def exactly(satisfied: int, count: int, fm: float = 0.2, **place: object) -> pd.DataFrame:
    """The first ``satisfied`` of ``count`` episodes succeed in everything, the others hit a column."""
    frame = episodes(count, 1.0, fm, **place)  # type: ignore[arg-type]
    good = np.arange(count) < satisfied
    for flag in ("cfr", "sr", "ok_obstacle"):
        frame[flag] = good
    return frame.assign(ok_formation=True, ok_flight=True, ok_action=True)


def gathered(made: Made) -> evidence.Evidence:
    return evidence.gather(rows.load(made.root), baselines=["swarm_rl"])


def judged(made: Made) -> list[str]:
    table = claims.table(evidence.gather(rows.load(made.root), baselines=["swarm_rl"]))
    assert len(table.rows) == 8
    assert all(row[3].command for row in table.rows if row[3].text == "not yet measured")
    return [row[3].text for row in table.rows]


def test_nothing_is_claimed_of_an_empty_store(made: Made) -> None:
    assert set(judged(made)) == {"not yet measured"}


def test_a_measured_failure_refutes_and_success_confirms(made: Made) -> None:
    policy = made.training(log=False)
    made.evaluation(made.policy(policy), episodes(200, 0.5, 0.2))
    assert judged(made)[0] == "not confirmed"  # CFR 0.5 is not 0.89
    better = made.training(log=False, steps=7_000_000)
    made.evaluation(made.policy(better), episodes(200, 0.92, 0.2))
    assert judged(made)[0] == "not yet measured"  # Swarm-RL was not flown
    made.evaluation(made.baseline("swarm_rl"), episodes(200, 0.85, 0.9, seed=1))
    assert judged(made)[0] == "confirmed"


def test_a_barely_trained_baseline_decides_nothing(made: Made) -> None:
    made.evaluation(made.policy(made.training(log=False)), episodes(200, 0.92, 0.2))
    learnt = made.baseline("swarm_rl") | {"steps": 20_000_000, "published_steps": 1_000_000_000}
    made.evaluation(learnt, episodes(200, 0.01, 0.05, seed=1))
    table = claims.table(evidence.gather(rows.load(made.root), baselines=["swarm_rl"]))
    verdict = table.rows[0][3]
    assert (verdict.text, verdict.details) == ("not yet measured", ("Swarm-RL: 2% of its published training",))
    told = table.rows[0][2].details[-1]  # what was seen of it stands there all the same
    assert told.startswith("Swarm-RL: FM 0.") and told.endswith(": not judged")
    assert verdict.command == (
        f"formctl train experiment=swarm_rl train.steps=1000000000 profile=laptop runs={made.root}"
    )


def both(first: int, second: int, count: int = 100) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Two methods' episodes of one draw; the better succeeds wherever the other does."""
    made = (exactly(k, count).assign(draw="one", train_seed=0) for k in (first, second))
    return next(made), next(made)


def test_an_interval_keeps_or_breaks_a_limit_or_leaves_it_open() -> None:
    assert [verdicts.reaches(*ends, 0.8) for ends in ((0.81, 0.9), (0.7, 0.79), (0.7, 0.9))] == [True, False, None]
    lost = [verdicts.Loss(0.0, low, high) for low, high in ((0.0, 0.1), (0.11, 0.2), (0.05, 0.15))]
    assert [verdicts.stays(one, 0.1) for one in lost] == [True, False, None]
    assert [verdicts.every(True, one) for one in (True, False, None)] == [True, False, None]
    assert verdicts.every(None, False) is False


def test_the_interval_of_a_loss_is_newcombes() -> None:
    """His example: 56 of 70 against 48 of 80 differ by 0.20 [0.0524, 0.3339] (Newcombe 1998, table II, row a)."""
    lost = verdicts.loss(stats.Rate(56, 70, 1, *stats.wilson(56, 70)), stats.Rate(48, 80, 1, *stats.wilson(48, 80)))
    assert lost == pytest.approx((0.2, 0.0524, 0.3339), abs=5e-5)


def test_a_contest_is_decided_by_the_exact_test_over_all_others() -> None:
    first, second = both(98, 91)
    (alone,) = verdicts.contests(first, [second])
    p = binomtest(0, 7).pvalue
    assert (alone.n, alone.p, alone.ahead) == (100, pytest.approx(p), True)
    assert verdicts.contests(second, [first])[0].ahead is False
    four = verdicts.contests(first, [second] * 4)  # Holm makes 0.0156 four times that
    assert [one.ahead for one in four] == [None] * 4 and four[0].p == pytest.approx(4 * p)
    assert str(alone) == "100 shared episodes, p = 0.016"


def test_seeds_that_disagree_decide_nothing() -> None:
    first, second = both(98, 80)
    (opposite,) = verdicts.contests(
        pd.concat([first, second.assign(train_seed=1)]), [pd.concat([second, first.assign(train_seed=1)])]
    )
    assert (opposite.p, opposite.ahead) == (1.0, None)
    shared = flown.paired(pd.concat([first, first.assign(train_seed=1)]), second, ["cfr"])
    assert shared["pair"].nunique() == 2  # one against all
    assert flown.paired(first, second.assign(draw="two"), ["cfr"]).empty
    assert verdicts.contests(first, [second.assign(draw="two")])[0] == (0, 1.0, None)


def swept(made: Made, ours: dict[int, int], rival: tuple[int, int], fm: float = 0.1) -> list[verdicts.Part]:
    """Claim 2 of a policy with so many successes of 1,000 at 5 and 20 columns, and of a planner at 20."""
    policy = made.policy(made.training(log=False))
    flights = [
        exactly(k, 1000, fm * columns / 20, scenario="static", columns=columns, balls=0) for columns, k in ours.items()
    ]
    made.evaluation(policy, [episodes(100, 0.9), *flights])
    made.evaluation(made.baseline("rmader"), exactly(*rival, scenario="static", columns=20, balls=0))
    return claims.sweeps(gathered(made))[:3]


def test_a_planners_few_perfect_flights_are_not_better(made: Made) -> None:
    """25 of 25 beside 960 of 1000: of the 25 that both flew not one differs."""
    kept, error, rival = swept(made, {5: 1000, 20: 960}, (25, 25))
    assert (kept.holds, error.holds, rival.holds) == (True, True, None)
    assert rival.seen == "20 columns: ours 960/1000, R-MADER 25/25; 25 shared episodes, p = 1.000"
    assert (
        rival.command == "formctl eval --baseline rmader scenario=static --grid columns=20 eval.episodes=1000 "
        f"profile=laptop runs={made.root}"
    )
    assert rival.lines() == [f"{rival.seen} (undecided: too few episodes)"]


def test_no_baseline_is_better_where_ours_wins_on_shared_episodes(made: Made) -> None:
    assert swept(made, {5: 1000, 20: 960}, (10, 25))[2].holds is True
    worse = swept(Made(made.root.parent / "other"), {5: 1000, 20: 500}, (1000, 1000))
    assert [part.holds for part in worse] == [False, True, False]


def test_fm_that_grows_over_a_sweep_refutes(made: Made) -> None:
    assert [part.holds for part in swept(made, {5: 1000, 20: 960}, (10, 25), fm=0.4)] == [True, False, True]


def test_a_barely_trained_baseline_is_no_rival(made: Made) -> None:
    learnt = made.baseline("swarm_rl") | {"steps": 20_000_000, "published_steps": 1_000_000_000}
    made.evaluation(learnt, exactly(1, 1000, scenario="static", columns=20, balls=0))
    (seen,) = [part.seen for part in swept(made, {5: 1000, 20: 960}, (10, 25)) if "shared" in part.seen]
    assert "R-MADER" in seen


@pytest.mark.parametrize(("theirs", "holds"), [(950, True), (999, False)])
def test_swarm_rls_rate_is_similar_unless_the_test_says_better(made: Made, theirs: int, holds: bool) -> None:
    made.evaluation(made.policy(made.training(log=False)), exactly(947, 1000, 0.2))
    made.evaluation(made.baseline("swarm_rl"), exactly(theirs, 1000, 0.9))
    assert claims.main_scene(gathered(made))[-1].holds is holds


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
    parts = claims.swarm_rl(gathered(made))
    assert [part.holds for part in parts if part.measured] == [holds, holds]
    assert claims.table(gathered(made)).notes[0].startswith("One training seed behind No. 3: ")


def arms(made: Made, satisfied: dict[str, int], hits: int = 0, late: int = 0) -> evidence.Evidence:
    """Arms of the curriculum with so many successes of 1,000; ``none`` is hit by balls, ``dynamic`` late so often."""
    for name, k in satisfied.items():
        frame = exactly(k, 1000)
        if name == "none":
            frame["hit_ball"] = np.arange(1000) < hits
        if name == "three_period_dynamic":
            frame["ok_flight"] = np.arange(1000) >= late
        made.evaluation(made.policy(made.training(log=False, curriculum=name, name=name)), frame)
    return gathered(made)


def test_a_difference_within_chance_is_undecided(made: Made) -> None:
    seen = arms(made, {"three_period": 941, "none": 936, "two_period": 970, "three_period_dynamic": 900})
    parts = {
        part.seen.split(",")[1].split(" 0.")[0].strip(): part for part in claims.curriculum(seen) if "SR" in part.seen
    }
    assert {name: part.holds for name, part in parts.items()} == {"w/o CL": None, "2-period": False, "3-period": True}
    assert parts["w/o CL"].seen == "SR 0.941 (941/1000), w/o CL 0.936 (936/1000); 1000 shared episodes, p = 0.062"


@pytest.mark.parametrize(("hits", "holds"), [(30, True), (2, None)])
def test_balls_are_judged_on_shared_episodes(made: Made, hits: int, holds: bool | None) -> None:
    parts = claims.curriculum(arms(made, {"three_period": 941, "none": 941}, hits=hits))
    (part,) = [part for part in parts if "no ball hit" in part.seen]
    assert part.holds is holds


@pytest.mark.parametrize(("late", "holds"), [(0, False), (300, True), (100, None)])
def test_late_is_more_than_slightly_late(made: Made, late: int, holds: bool | None) -> None:
    parts = claims.curriculum(arms(made, {"three_period": 941, "three_period_dynamic": 941}, late=late))
    assert parts[-1].holds is holds and parts[-1].seen.startswith("in time: 1.000, dynamic-only")


def test_arms_that_were_not_flown_are_asked_for(made: Made) -> None:
    parts = claims.curriculum(arms(made, {"none": 900}))
    assert [part.seen for part in parts] == ["Ours", "3-period, dynamic", "2-period"]
    assert not any(part.measured for part in parts)


@pytest.mark.parametrize(("satisfied", "holds"), [(900, False), (600, True), (800, None)])
def test_a_variant_is_good_by_its_interval(made: Made, satisfied: int, holds: bool | None) -> None:
    for name, k in (("attention", 950), ("mlp", satisfied)):
        made.evaluation(made.policy(made.training(log=False, encoder=name, name=name)), exactly(k, 1000))
    found = {part.seen.split(":")[0]: part for part in claims.encoder(gathered(made))}
    assert (found["Ours"].holds, found["MLP"].holds) == (True, holds)


def test_one_seed_is_said_of_claims_that_rest_on_one(made: Made) -> None:
    made.evaluation(made.policy(made.training(log=False)), episodes(200, 0.92, 0.2))
    (note,) = claims.table(gathered(made)).notes
    assert note.startswith("One training seed behind No. 1, 4: ")
    made.evaluation(made.policy(made.training(1, log=False)), episodes(200, 0.92, 0.2))
    assert claims.table(gathered(made)).notes == ()


def study(made: Made) -> None:
    """Three trials; the second is the winner and was flown on fresh episodes too."""
    folder = made.run("search", "stage1")
    fresh = {name: pd.array([None, value, None], "Int64") for name, value in (("sr_fresh_k", 180), ("sr_fresh_n", 200))}
    table = trials(3).assign(sr_k=[150, 190, 160], sr=[0.75, 0.95, 0.8], **fresh)
    columns = ["w_formation", "w_flight", "w_obstacle", "w_action"]
    table[columns] = [[0.1, 0.2, 0.3, 0.4], [0.25, 0.25, 0.3, 0.2], [0.4, 0.3, 0.2, 0.1]]
    table.to_parquet(folder / "trials.parquet", index=False)


def weighted(made: Made, weights: list[float], satisfied: int) -> None:
    id = made.training(log=False)
    folder = next(made.root.glob(f"train/*/{id}"))
    for file, path in (("run.json", ("method",)), ("config.yaml", ())):
        tree = json.loads((folder / file).read_text())
        (tree[path[0]] if path else tree)["weights"] = weights
        (folder / file).write_text(json.dumps(tree))
    made.evaluation(made.policy(id), exactly(satisfied, 1000))


def test_weights_transfer_only_where_a_policy_was_trained_with_them(made: Made) -> None:
    study(made)
    weighted(made, [0.25, 0.25, 0.25, 0.25], 990)
    part = transfer.judge(gathered(made))[0]
    assert (part.measured, part.holds) == (False, None)
    begun, flown_then = part.command.split(" && ")
    here = f"profile=laptop runs={made.root}"
    assert begun == f"formctl train curriculum=three_period {here} weights=@stage1/best name=carried"
    assert flown_then == f"formctl eval --policy carried scenario=mixed {here}"
    weighted(made, [0.4, 0.3, 0.2, 0.1], 900)
    part = transfer.judge(gathered(made))[0]
    assert part.holds is True
    assert part.seen == "SR of the weights of trial 2: 0.800 in stage 1, 0.900 in the mixed scene (160/200, 900/1000)"


@pytest.mark.parametrize(("satisfied", "holds"), [(900, True), (700, False), (800, None)])
def test_the_winner_is_held_to_its_fresh_rate(made: Made, satisfied: int, holds: bool | None) -> None:
    study(made)
    weighted(made, [0.25, 0.25, 0.3, 0.2], satisfied)
    part = transfer.judge(gathered(made))[0]
    assert part.seen.startswith("SR of the weights of trial 1: 0.900 in stage 1")
    assert part.holds is holds


def deployed(
    made: Made, success: float, smooth: bool, deploy: str = "mocap", sim: str = "mujoco", **changed: object
) -> str:
    """A training's flights in the deployment scenes, all smooth or none."""
    id = str(changed.pop("of", "")) or made.training(log=False, **changed)
    for number, scenario in enumerate(deployment.SCENES):
        flights = episodes(100, success, scenario=scenario, columns=2, balls=1, seed=number, sim=sim)
        settings = {"scenario": {"hit_radius": 0.15}, "deploy": DEPLOY}
        made.evaluation(made.policy(id), flights.assign(deploy=deploy, ok_action=smooth), config=settings)
    return id


REAL = {"experiment": "sim_to_real", "curriculum": "none", "scenario": "real_mixed"}


@pytest.mark.parametrize(
    ("success", "smooth", "holds"), [(0.9, True, True), (0.9, False, False), (0.1, True, False), (0.1, False, False)]
)
def test_real_flight_is_judged_by_the_papers_recipe_and_smooth(
    made: Made, success: float, smooth: bool, holds: bool
) -> None:
    deployed(made, success, smooth)
    deployed(made, 0.95, True, **REAL)
    seen = gathered(made)
    assert [method.facts.experiment for method in seen.expected] == [""] and len(seen.shown) == 2
    parts = transfer.judge(seen)[1:]
    assert [part.holds for part in parts] == [holds] * 3
    assert all("Ours, MAPPO: " in part.seen and f"smooth in {100 * smooth}/100" in part.seen for part in parts)
    assert all("for real flights: " in part.lines()[1] and part.lines()[1].endswith("not judged") for part in parts)


def test_a_policy_trained_for_flight_confirms_nothing(made: Made) -> None:
    deployed(made, 0.95, True, **REAL)
    parts = transfer.judge(gathered(made))[1:]
    assert [(part.measured, part.holds) for part in parts] == [(False, None)] * 3
    verdict = claims.table(gathered(made)).rows[7]
    assert "not judged" in verdict[2].text and verdict[3].text == "not yet measured"


def test_deployed_flights_are_those_in_mujoco_over_motion_capture(made: Made) -> None:
    id = deployed(made, 0.2, True, deploy="harsh", sim="torch")
    for deploy, sim, success in (("mocap", "torch", 0.3), ("harsh", "mujoco", 0.4), ("mocap", "mujoco", 0.9)):
        deployed(made, success, True, deploy, sim, of=id)
        seen = gathered(made)
        _, flights = flown.deployed(seen, "real_mixed", flown.full(seen)) or pytest.fail("no flights")
        assert (set(flights["deploy"]), set(flights["sim"])) == ({deploy}, {sim})


def test_what_fails_does_not_hide_what_was_not_measured(made: Made) -> None:
    study(made)
    deployed(made, 0.1, False)
    verdict = claims.table(gathered(made)).rows[7][3]
    assert verdict.text == "not confirmed"
    assert verdict.details == ("not yet measured: the full method trained with weights of stage 1",)
    here = f"profile=laptop runs={made.root}"
    assert verdict.command.startswith(f"formctl train curriculum=three_period {here} weights=@stage1/best")


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
    assert judged["2"] == "not yet measured" and judged["7"] == "not yet measured"
    assert "CFR" in table.rows[1][2].text and table.rows[1][3].details == (verdicts.UNDECIDED,)
    assert [section.key for section in page.sections][-2:] == ["deployment", "claims"]
