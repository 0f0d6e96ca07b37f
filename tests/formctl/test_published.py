"""A published store: its manifest, its rows flown again, and settings of earlier versions."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from baselines.sanity import StraightLine
from formctl import store
from formctl.evaluation import migrations, reverify
from formctl.settings import compose, restore
from formctl.store import manifest, provenance
from tests.formctl.conftest import TINY, run

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sealed store with one evaluation."""
    root = tmp_path_factory.mktemp("published")
    answer = run("eval", "--baseline", "straight_line", *TINY, f"runs={root}")
    assert answer.code == 0, answer.err
    assert run("runs", "seal", str(root)).code == 0
    return root


def test_rows_flown_again_are_the_published_ones(published: Path) -> None:
    answer = run("runs", "verify", str(published))
    assert answer.code == 0, answer.err
    (outcome,) = reverify.sample(published, seconds=60)
    assert (outcome.rows, outcome.equal, outcome.difference, outcome.wrong) == (3, 3, 0.0, "")


def test_a_changed_row_is_found(published: Path) -> None:
    path = next(published.glob("eval/*/*/episodes.parquet"))
    kept = path.read_bytes()
    rows = pd.read_parquet(path)
    rows.assign(mean_speed=rows["mean_speed"] + 0.1).to_parquet(path)
    try:
        assert any("is not the published file" in what for _, what in manifest.differences(published))
        answer = run("runs", "verify", str(published))
        (outcome,) = reverify.sample(published, seconds=60)
    finally:
        path.write_bytes(kept)
    assert answer.code == 1
    assert "mean_speed differs by 0.1" in outcome.wrong


def test_another_processor_excuses_only_methods_that_are_not_portable(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (evaluation,) = store.scan(published, kind="eval")
    compared = reverify._compared

    def verdict() -> str:
        return reverify.check(evaluation, published, np.random.default_rng(0)).verdict

    assert verdict() == "confirmed"
    monkeypatch.setattr(reverify, "_compared", lambda *given: replace(compared(*given), wrong="fm differs by 2"))
    monkeypatch.setattr(StraightLine, "capabilities", replace(StraightLine.capabilities, portable=False))
    assert verdict() == "fm differs by 2"
    monkeypatch.setattr(provenance, "processor", lambda: "another")
    assert verdict() == "another processor, another course: fm differs by 2"
    monkeypatch.setattr(StraightLine, "capabilities", replace(StraightLine.capabilities, portable=True))
    assert verdict() == "fm differs by 2"


def test_a_file_too_many_and_one_too_few_are_found(published: Path) -> None:
    extra, lost = published / "extra.txt", next(published.glob("eval/*/*/config.yaml"))
    extra.write_text("x")
    text = lost.read_text()
    lost.unlink()
    try:
        found = {path.name: what for path, what in manifest.differences(published)}
    finally:
        extra.unlink()
        lost.write_text(text)
    assert found["config.yaml"] == "is missing"
    assert "is not in the manifest" in found["extra.txt"]


def test_a_store_too_large_to_travel_is_refused(published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(manifest, "LIMIT", 100)
    answer = run("runs", "seal", str(published))
    assert answer.code == 2
    assert "remove runs" in answer.line


def test_the_reference_is_what_was_published() -> None:
    reference = ROOT / "runs" / "reference"
    assert not list(manifest.differences(reference))
    assert json.loads((reference / manifest.NAME).read_text())["bytes"] <= manifest.LIMIT
    assert not list(manifest.personal(reference))


@pytest.mark.parametrize("path", sorted((ROOT / "runs" / "reference").glob("eval/*/*")), ids=lambda path: path.name)
def test_reference_settings_of_any_version_can_be_flown(path: Path) -> None:
    tree = {key: value for key, value in store.Run(path).config.items() if key != "baseline"}
    config = restore(migrations.complete(tree))
    assert (config.scenario.name, config.eval.seconds) == (tree["scenario"]["name"], tree["eval"]["seconds"])


def test_settings_of_an_earlier_version_get_the_value_of_then_or_are_refused() -> None:
    tree = compose(["scenario=static"]).tree
    before = {key: value for key, value in tree["observation"].items() if key != "lookahead"}
    completed = migrations.complete(tree | {"observation": before, "search": {}})
    assert completed["observation"]["lookahead"] == 0.0
    assert restore(completed).scenario.name == "static"
    shorter = {key: value for key, value in tree["scenario"].items() if key != "ball_radius"}
    with pytest.raises(store.StoreError, match=r"too old to be flown again: it does not say scenario\.ball_radius"):
        migrations.complete(tree | {"scenario": shorter}, "run")
