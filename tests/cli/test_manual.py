"""``conf keys``: the comments of the YAML files become the manual."""

from collections.abc import Callable
from pathlib import Path

from formctl.settings import manual
from tests.cli.conftest import Result


def test_comments_stand_beside_the_value_or_above_the_key(tmp_path: Path) -> None:
    path = tmp_path / "group.yaml"
    path.write_text(
        "# The file's own sentence.\n"
        "name: x\n"
        "speed: 2.0  # m/s\n"
        "# above, in\n"
        "# two lines\n"
        "formation: '#1'\n"
        "places: [[1, 2],\n  [3, 4]]  # m\n"
        "bare: 1\n"
        "nested:\n"
        "  inner: 1  # of the nest\n"
        "periods:\n"
        "  - share: 15  # relative\n"
        "  - share: 150\n"
    )
    assert manual.comments(path) == {
        "name": "",
        "speed": "m/s",
        "formation": "above, in two lines",
        "places": "m",
        "bare": "",
        "nested": "",
        "nested.inner": "of the nest",
        "periods": "",
        "periods.share": "relative",
    }


def test_a_choice_is_explained_by_the_file_it_builds_on_and_then_by_its_own() -> None:
    assert manual.explain("scenario", "mixed")["columns"].endswith("; here: paper, Table I")
    assert manual.explain("scenario", "mixed")["columns"].startswith("number of columns")
    assert manual.title("scenario", "mixed") == "The paper's main scenario: 10 columns and 2 balls."


def test_keys_lists_key_value_and_meaning(formctl: Callable[..., Result]) -> None:
    result = formctl("conf", "keys", "search.trials", "logger")
    assert result.out.splitlines() == [
        "key                 value        meaning",
        "search.trials       8            total number of trials in the study, finished ones included",
        "logger              tensorboard  TensorBoard events beside metrics.jsonl.",
        "logger.name         tensorboard  label of this choice",
        "logger.tensorboard  true         write event files into the run's folder",
        'logger.tracker                   wandb, mlflow or trackio, each an extra of that name; "": none',
        "logger.project      formctl      the tracker's name for all of these runs",
        "logger.online       false        true: to the service that the tracker's own environment variables name",
    ]


def test_keys_follow_the_choices_and_values_typed(formctl: Callable[..., Result]) -> None:
    out = formctl("conf", "keys", "scenario@search.scenario=static", "search.scenario", "scenario=free", "seed=4").out
    rows = {line.split()[0]: line.split()[1:] for line in out.splitlines()}
    assert rows["search.scenario"][:3] == ["static", "Columns", "only:"]
    assert rows["search.scenario.columns"][0] == "10"
    assert "Obstacle-free" not in out
