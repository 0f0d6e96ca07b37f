"""Recorded episodes against the rows of the same episodes, computed here from the MCAP alone; and replays of them."""

import json
import shutil
from collections import defaultdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from analysis.recordings import mcap_reader, page
from formctl import store
from formctl.evaluation import methods
from tests.formctl.conftest import TINY, run

SCENE = [
    "scenario=mixed",
    "scenario.columns=2",
    "scenario.field=[2,5]",
    "scenario.throw_time=[0.5,1.5]",
    "scenario.ball_aim=drone",
]
FLOWN = ["eval.episodes=6", "eval.seconds=4.4", "eval.time_limit=4.2"]


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """A store with one evaluation of the straight-line agent, every episode of it recorded."""
    folder = tmp_path_factory.mktemp("recorded")
    words = ["--baseline", "straight_line", "--record", "first=6", *TINY, *SCENE, *FLOWN, f"runs={folder}", "name=near"]
    answer = run("eval", *words)
    assert answer.code == 0, answer.err
    assert "recorded: mcap/episode_0.mcap" in answer.out
    return folder


@pytest.fixture(scope="module")
def evaluation(root):
    return store.latest(root, "eval", "near")


def messages(path: Path):
    """Metadata and decoded messages by topic, read by the mcap library alone."""
    found = defaultdict(list)
    factory = DecoderFactory()
    with path.open("rb") as stream:
        reader = make_reader(stream)
        for schema, channel, message in reader.iter_messages(["/method1/poses", "/method1/throw"]):
            decode = factory.decoder_for("protobuf", schema) if schema.encoding == "protobuf" else json.loads
            found[channel.topic].append(decode(message.data))
        return {entry.name: entry.metadata for entry in reader.iter_metadata()}, found


def closest(start, end):
    """Least length of vectors that move straight from ``start`` to ``end`` (..., k)."""
    move = end - start
    share = -np.sum(start * move, -1) / np.maximum(np.sum(move**2, -1), 1e-12)
    return np.linalg.norm(start + np.clip(share, 0, 1)[..., None] * move, axis=-1)


def recompute(path: Path):
    """Collisions, times and FM of an episode from the drones' poses and what is written about the scene."""
    metadata, found = messages(path)
    scene = json.loads(metadata["formctl"]["scene"])
    x = np.array([[[p.position.x, p.position.y, p.position.z] for p in m.poses] for m in found["/method1/poses"]])
    time = scene["period"] * np.arange(len(x))
    columns = np.array(scene["columns"]).reshape(-1, 1, 1, 2)
    gaps = {"column": closest(x[:-1, :, :2] - columns, x[1:, :, :2] - columns).min(0)}
    gaps["ball"] = np.full(x[1:, :, 0].shape, np.inf)
    for throw in found["/method1/throw"]:
        t = (time - throw["time"])[:, None]
        fallen = np.minimum(t, throw["landing"] - throw["time"])
        ball = np.array(throw["origin"]) + np.array(throw["velocity"]) * fallen - [0, 0, 9.81 / 2] * fallen**2
        flying = (time[:-1] >= throw["time"] - 1e-6) & (time[:-1] < throw["landing"] - 1e-6)
        apart = closest(ball[:-1, None] - x[:-1], ball[1:, None] - x[1:])
        gaps["ball"] = np.where(flying[:, None], np.minimum(gaps["ball"], apart), gaps["ball"])
    pairs = closest(x[:-1, :, None] - x[:-1, None], x[1:, :, None] - x[1:, None])
    gaps["drone"] = (pairs + 1e9 * np.eye(x.shape[1])).min(-1)
    low, high = scene["altitude"]
    touched = {cause: (gap < scene["hit_radius"]).any(1) for cause, gap in gaps.items()}
    touched |= {"ground": (x[1:, :, 2] < low).any(1), "ceiling": (x[1:, :, 2] > high).any(1)}
    passed = np.flatnonzero((x[1:, :, 1] > scene["goal"]).all(1))
    limit = round(scene["time_limit"] / scene["period"])
    reached = len(passed) > 0 and passed[0] + 1 <= limit
    end = passed[0] + 1 if reached else limit  # steps
    first = {cause: np.flatnonzero(hit[:end]) for cause, hit in touched.items()}
    contacts = {cause: when[0] for cause, when in first.items() if len(when)}
    slots = np.array(scene["slots"])
    error = [laplacian_distance(at, slots) for at in x[1 : end + 1]]
    return {
        "cfr": reached and not contacts,
        "reached": reached,
        "failure": min(contacts, key=contacts.get) if contacts else "" if reached else "late",
        "time_to_goal": time[end] if reached else np.nan,
        "fm": float(np.mean(error)),
        **{f"hit_{cause}": cause in contacts for cause in touched},
        **{f"min_{cause}": gap[:end].min() for cause, gap in gaps.items()},
    }


def laplacian_distance(points, slots):
    """Frobenius norm of the difference of the two formations' Laplacians, diag(D) - A."""
    a, b = (np.linalg.norm(p[:, None] - p, axis=-1) for p in (points, slots))
    return np.linalg.norm((np.diag(a.sum(0)) - a) - (np.diag(b.sum(0)) - b))


def test_rows_recomputed_from_the_recordings_are_the_rows(evaluation):
    rows = pd.read_parquet(evaluation.path / "episodes.parquet")
    assert evaluation.record["recordings"] == [f"mcap/episode_{number}.mcap" for number in range(6)]
    for number, row in rows.iterrows():
        found = recompute(evaluation.path / "mcap" / f"episode_{number}.mcap")
        for key in ("cfr", "reached", "failure", "hit_column", "hit_ball", "hit_drone", "hit_ground", "hit_ceiling"):
            assert found[key] == row[key], (number, key)
        for key in ("fm", "time_to_goal", "min_column", "min_ball", "min_drone"):
            if np.isfinite(found[key]) or not np.isnan(row[key]):
                assert found[key] == pytest.approx(row[key], abs=1e-4, nan_ok=True), (number, key)
    assert rows["cfr"].nunique() == 2 and rows["hit_column"].any()


def test_a_recording_says_where_it_comes_from(evaluation):
    recording = mcap_reader.read(evaluation.path / "mcap" / "episode_3.mcap")
    assert recording.scene.episode == 3 and recording.scene.bank == evaluation.record["bank"]["sha256"]
    assert recording.traces[0].facts == evaluation.record["method"]
    assert set(recording.provenance) == {"git", "versions", "argv"}
    assert np.isfinite(recording.traces[0].reward).all() and np.abs(recording.traces[0].command).max() <= 1


def test_replay_flies_the_same_episode_beside_another_method(root, evaluation, tmp_path):
    stem = tmp_path / "again"
    answer = run("replay", "near:3", "--vs", "hover", "--out", str(stem), "--runs", str(root))
    assert answer.code == 0 and answer.err == "", answer.err
    again, before = (
        mcap_reader.read(stem.with_suffix(".mcap")),
        mcap_reader.read(evaluation.path / "mcap" / "episode_3.mcap"),
    )
    assert [trace.method for trace in again.traces] == ["straight_line", "hover"]
    assert np.array_equal(again.traces[0].position, before.traces[0].position)
    assert np.abs(again.traces[1].velocity).max() < 0.5
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".html", ".mcap", ".png"]
    assert page.render(again) == stem.with_suffix(".html").read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["near:6"], "has no episode 6: its episodes are 0 to 5"),
        (["near"], "cannot read 'near': write RUN:EPISODE, for example main:7, or the path of an .mcap file"),
        (["far:1"], "no eval run with an episodes.parquet 'far'"),
        (["near:1", "--vs", "nobody"], "no run with a policy.pt 'nobody'"),
        (["near:1", "--vs", "nobody"], "shipped with formctl: mixed, sim_to_real, swarm_rl; baselines: hover, "),
        (["near:1", "--policy", "mixed"], "was flown by the baseline straight_line: leave --policy mixed out"),
        (["nowhere.mcap"], "there is no recording nowhere.mcap"),
        (
            ["near:1", "--video", "film.avi"],
            "film.avi cannot be made: the film has to end in .mp4 or .gif",
        ),
        (["near:1", "--video", "near.png"], "near.png cannot be made: the film has to end in .mp4 or .gif"),
    ],
)
def test_wrong_replays(root, words, message):
    answer = run("replay", *words, "--runs", str(root))
    assert answer.code == 2 and message in answer.line


@pytest.fixture(scope="module")
def shipped(tmp_path_factory):
    """A store with an evaluation of every policy that ships with formctl, under the policy's name, and nothing else."""
    folder = tmp_path_factory.mktemp("shipped")
    for name in methods.shipped():
        answer = run("eval", "--policy", name, *TINY, *SCENE, f"runs={folder}", f"name={name}")
        assert answer.code == 0, answer.err
    return folder


@pytest.fixture
def by_another(shipped, tmp_path):
    """Make the evaluation of ``mixed`` one that training run ``text`` has flown; the new evaluation's path."""

    def change(text):
        copy = tmp_path / "eval" / "changed" / "20260101T000000-0000"
        shutil.copytree(store.latest(shipped, "eval", "mixed").path, copy)
        record = json.loads((copy / "run.json").read_text())
        record["method"]["run"] = text
        (copy / "run.json").write_text(json.dumps(record))
        return copy

    return change


@pytest.mark.parametrize("name", methods.shipped())
def test_a_shipped_policy_flies_its_episodes_again(shipped, tmp_path, name):
    answer = run("replay", f"{name}:2", "--out", str(tmp_path / "again"), "--runs", str(shipped))
    assert answer.code == 0 and answer.err == "", answer.err
    known = methods.policy(str(methods.shipped()[name]), shipped).facts
    assert mcap_reader.read(tmp_path / "again.mcap").traces[0].facts == known


def test_a_policy_of_another_training_run_is_refused(shipped, tmp_path):
    words = ("replay", "mixed:2", "--out", str(tmp_path / "again"), "--runs", str(shipped), "--policy")
    answer = run(*words, "sim_to_real")
    given, flew = (methods.policy(name, shipped).facts for name in ("sim_to_real", "mixed"))
    assert answer.code == 2 and f"--policy sim_to_real comes from training run {given['run']}, but " in answer.line
    assert answer.line.endswith(f" was flown by {flew['name']} of training run {flew['run']}")
    assert run(*words, "mixed").code == 0


def test_a_policy_that_is_nowhere(by_another, tmp_path):
    answer = run("replay", f"{by_another('20260101T000000-0001')}:2", "--runs", str(tmp_path))
    assert answer.code == 2 and "(training run 20260101T000000-0001) is not in " in answer.line
    assert answer.line.endswith(" and does not ship with formctl: give --policy RUN, FILE or NAME")


def test_a_policy_whose_training_run_is_unknown_may_be_given(by_another, tmp_path):
    words = ("replay", f"{by_another('')}:2", "--out", str(tmp_path / "again"), "--runs", str(tmp_path))
    assert run(*words).code == 2
    answer = run(*words, "--policy", str(methods.shipped()["mixed"]))
    assert answer.code == 0 and answer.err == "", answer.err


def test_a_recording_cut_in_the_middle(evaluation, tmp_path):
    whole = (evaluation.path / "mcap" / "episode_0.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    answer = run("replay", str(tmp_path / "cut.mcap"))
    assert answer.code == 2 and "cut.mcap was cut off or is damaged" in answer.line
    assert [path.name for path in tmp_path.iterdir()] == ["cut.mcap"]


def test_a_changed_bank_is_noticed(root, evaluation, tmp_path):
    copy = tmp_path / "eval" / "other" / "20260101T000000-0000"
    shutil.copytree(evaluation.path, copy)
    record = json.loads((copy / "run.json").read_text())
    record["banks"][0]["sha256"] = "0" * 64
    (copy / "run.json").write_text(json.dumps(record))
    answer = run("replay", f"{copy}:1", "--runs", str(tmp_path))
    assert answer.code == 2 and "cannot be drawn again" in answer.line


def test_film_without_a_graphics_library_is_one_line(evaluation, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "glx")
    monkeypatch.setenv("DISPLAY", ":nowhere")
    film = tmp_path / "film.gif"
    words = [str(evaluation.path / "mcap" / "episode_0.mcap"), "--out", str(tmp_path / "x"), "--video", str(film)]
    answer = run("replay", *words)
    assert answer.code == 1 and "install libegl1 and libgl1-mesa-dri, or libosmesa6" in answer.line
    assert not film.exists()
