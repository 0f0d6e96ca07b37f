"""Who is who: roles, labels and what the paper calls a method."""

import json

import pytest

from analysis.data import evidence, lookup, rows
from analysis.data.methods import Method
from analysis.tables import main
from tests.analysis.synthetic import Made, episodes, trials


def only(made: Made, **changed: object) -> tuple[Method, str]:
    """The one method of a training flown in the mixed scene, and its name."""
    made.evaluation(made.policy(made.training(log=False, **changed)), episodes(5, 0.5))
    found = evidence.gather(rows.load(made.root))
    (method,) = found.methods.values()
    return method, found.names[method.key]


@pytest.mark.parametrize(
    ("changed", "role", "label"),
    [
        ({}, "ours", "Ours, MAPPO"),
        ({"algo": "shac"}, "ours", "Ours, SHAC"),
        ({"weights": "uniform"}, "other", "MAPPO, three periods, weights uniform"),
        ({"weights": "@stage1/trial=7"}, "other", "MAPPO, three periods, weights trial 7 of stage1"),
        ({"encoder": "mlp"}, "arm", "MAPPO, MLP"),
        ({"curriculum": "none"}, "arm", "MAPPO, w/o CL"),
        ({"scenario": "stage1"}, "other", "MAPPO, three periods, trained on stage1"),
        ({"experiment": "shac_dense", "curriculum": "none"}, "other", "MAPPO, shac dense"),
    ],
)
def test_ours_is_searched_weights_three_periods_attention_and_the_mixed_scene(
    made: Made, changed: dict[str, str], role: str, label: str
) -> None:
    method, name = only(made, **changed)
    assert (method.role, name) == (role, label)
    assert (method.paper_name == "ours") is (role == "ours")


def test_the_winner_of_a_search_is_known_by_its_weights(made: Made) -> None:
    """A training takes the winner as a trial of a run folder; another trial's weights are not the search's choice."""
    study = made.run("search", "stage1")
    table = trials(2).assign(sr_fresh_k=[None, 180.0], sr_fresh_n=[None, 200.0])
    table.to_parquet(study / "trials.parquet", index=False)
    for number, weights in enumerate(table[list(rows.WEIGHTS)].to_numpy().tolist()):
        id = made.training(number, log=False, weights=f"@{study}/trial={number}")
        record = next(made.root.glob(f"train/*/{id}/run.json"))
        facts = json.loads(record.read_text())
        facts["method"]["weights"] = weights
        record.write_text(json.dumps(facts))
        made.evaluation(made.policy(id), episodes(5, 0.5))
    found = evidence.gather(rows.load(made.root))
    names = {found.names[method.key]: method.role for method in found.methods.values()}
    assert names == {"Ours, MAPPO": "ours", "MAPPO, three periods, weights trial 0 of stage1": "other"}


def test_a_policy_trained_for_real_flights_fills_the_papers_row_there(made: Made) -> None:
    method, _ = only(made, scenario="real_mixed")
    assert method.for_flight and method.paper_name == "ours" and method.role == "other"


def test_a_baselines_name_and_role_are_those_of_its_yaml(made: Made) -> None:
    for name in ("rmader", "rmader_fair", "rmader_real", "hover"):
        made.evaluation(made.baseline(name), episodes(5, 0.5))
    found = evidence.gather(rows.load(made.root))
    seen = {found.names[method.key]: (method.role, method.paper_name) for method in found.methods.values()}
    assert seen == {
        "R-MADER": ("published", "rmader"),
        "R-MADER, fair": ("fair", ""),
        "R-MADER, for real flights": ("flight", ""),
        "Hover": ("sanity", ""),
    }
    (sets,) = lookup.parameter_sets(found.methods.values())
    assert [found.names[method.key] for method in sets] == ["R-MADER", "R-MADER, fair"]


def test_a_front_page_has_the_papers_methods_and_eight_rows_at_most(made: Made) -> None:
    for seed, learner in enumerate(("mappo", "shac", "a2c", "dqn", "sac", "td3", "ddpg", "trpo", "acer")):
        made.evaluation(made.policy(made.training(seed, log=False, algo=learner)), episodes(5, 0.5))
    for name in ("straight_line", "hover", "rmader"):
        made.evaluation(made.baseline(name), episodes(5, 0.5))
    found = evidence.gather(rows.load(made.root))
    front = main.front_page(main.tables(found)[0], found)
    assert len(front.rows) == main.FRONT_ROWS == 8
    assert [column.key for column in front.columns] == list(main.FRONT_COLUMNS)


def test_a_front_page_shows_one_agent_that_avoids_nothing(made: Made) -> None:
    for name, success in (("hover", 0.0), ("straight_line", 1.0), ("rmader", 0.5)):
        made.evaluation(made.baseline(name), episodes(5, success))
    found = evidence.gather(rows.load(made.root))
    front = main.front_page(main.tables(found)[0], found)
    assert [row[0].text for row in front.rows] == ["R-MADER", "Straight line"]
