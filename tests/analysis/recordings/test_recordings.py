"""Recordings as files: the same numbers back, the schemas that Foxglove knows, one line for what cannot be read."""

import dataclasses
import itertools
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from analysis.figures import topview
from analysis.figures.behaviour import behaviour_data, draw_behaviour, flight_of, shown, span
from analysis.figures.topview import DrawnFlight
from analysis.recordings import Event, Plan, Recording, RecordingError, Scene, Throw, Trace, merge, page, same
from analysis.recordings.mcap_reader import read
from analysis.recordings.mcap_writer import write

NAMES = ["ours", "other"]
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


def trace(method: str, hit: bool, seed: int) -> Trace:
    """Two seconds of three drones along the course, with one ball and awkward numbers."""
    random = np.random.default_rng(seed)
    samples, drones = 101, 3
    slots = np.array([[1.0, 0.0, 1.5], [-0.5, 0.866, 1.5], [-0.5, -0.866, 1.5]])
    way = 0.04 * np.arange(samples)[:, None, None] * np.array([0.0, 1.0, 0.0])
    throw = Throw(0, 0.5, 1.3, (2.0, 2.0, 1.0), (-2.5, 0.1, 3.9))
    aloft = 0.02 * np.arange(samples)[:, None] - throw.time
    ball = np.array(throw.origin) + np.array(throw.velocity) * aloft - [0, 0, 4.905] * aloft**2
    ball[aloft[:, 0] < 0] = np.nan
    gap = random.uniform(0.5, 9, (samples - 1, drones, 3))
    gap[:10, :, 1] = np.inf
    gap[60, 1, 1] = 0.1 if hit else 0.4
    events = [Event(0.5, "throw", "ball 0 is thrown"), *([Event(1.22, "contact", "hit", 1, "ball")] if hit else [])]
    row = {"cfr": not hit, "failure": "ball" if hit else "", "first_contact_time": 1.22 if hit else None}
    return Trace(
        method=method,
        facts={"name": method, "kind": "baseline", "weights": [0.1, 0.2]},
        row=row | {"fm": 0.3, "time_to_goal": 1.9, "reached": True},
        position=slots + way + random.normal(0, 0.05, (samples, drones, 3)).astype(np.float32),
        attitude=np.tile([1.0, 0.0, 0.0, 0.0], (samples, drones, 1)) + 1e-3 * random.normal(size=(samples, drones, 4)),
        velocity=random.normal(size=(samples, drones, 3)),
        throttle=random.uniform(size=(samples, drones, 4)),
        ball=ball[:, None],
        command=random.uniform(-1, 1, (samples - 1, drones, 4)),
        reward=random.normal(size=(samples - 1, drones, 4)),
        gap=gap,
        formation_error=random.uniform(0, 2, samples - 1),
        throws=[throw],
        events=events,
        plans=[Plan(0.2, 1, random.normal(size=(5, 4)))],
    )


def scene() -> Scene:
    return Scene(
        scenario="mixed",
        episode=7,
        bank="abc",
        columns=np.array([[0.25, 3.0], [-1.0, 4.5]]),
        slots=np.array([[1.0, 0.0, 0.0], [-0.5, 0.866, 0.0], [-0.5, -0.866, 0.0]]),
        velocity=np.array([0.0, 2.0, 0.0]),
        goal=5.0,
        time_limit=20.0,
        altitude=(0.2, 2.8),
        column_radius=0.15,
        ball_radius=0.15,
        hit_radius=0.15,
        period=0.02,
    )


@pytest.fixture(scope="module")
def recording() -> Recording:
    traces = (trace("ours", False, 1), trace("other", True, 2))
    return Recording(scene(), traces, {"git": {"commit": "0123", "dirty": False}})


@pytest.fixture(scope="module")
def file(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(recording, tmp_path_factory.mktemp("recording") / "episode.mcap")


def test_every_number_comes_back(recording: Recording, file: Path) -> None:
    back = read(file)
    assert same(back, recording)
    changed = dataclasses.replace(recording.traces[0], reward=recording.traces[0].reward + 1e-12)
    assert not same(back, dataclasses.replace(recording, traces=(changed, recording.traces[1])))


def test_the_same_recording_gives_the_same_bytes(recording: Recording, file: Path, tmp_path: Path) -> None:
    assert write(recording, tmp_path / "again.mcap").read_bytes() == file.read_bytes()


def test_schemas_are_those_that_foxglove_knows(file: Path) -> None:
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    schemas = {c.topic: summary.schemas[c.schema_id] for c in summary.channels.values()}
    encodings = {c.topic: c.message_encoding for c in summary.channels.values()}
    known = {"/tf": "foxglove.FrameTransforms", "/scene": "foxglove.SceneUpdate"}
    for method in ("/method1", "/method2"):
        known |= {f"{method}/poses": "foxglove.PosesInFrame", f"{method}/scene": "foxglove.SceneUpdate"}
        known |= {f"{method}/log": "foxglove.Log"}
    assert {name: schema.name for name, schema in schemas.items() if schema.encoding == "protobuf"} == known
    plain = {name for name in schemas if name not in known}
    assert {name.split("/")[2] for name in plain} == {
        "action",
        "reward",
        "state",
        "clearance",
        "throw",
        "event",
        "plan",
    }
    assert {encodings[name] for name in plain} == {"json"} and {encodings[name] for name in known} == {"protobuf"}


def test_messages_carry_simulated_time(file: Path, recording: Recording) -> None:
    with file.open("rb") as stream:
        decoded = list(make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/tf"]))
    assert [message.log_time for _, _, message, _ in decoded] == [20_000_000 * k for k in range(101)]
    last = decoded[-1][3].transforms
    assert {t.child_frame_id for t in last} == {f"method{m}/drone{d}" for m in (1, 2) for d in range(3)}
    assert last[0].timestamp.seconds == 2 and last[0].timestamp.nanos == 0
    assert last[4].translation.y == recording.traces[1].position[-1, 1, 1]


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.999])
def test_a_recording_cut_in_the_middle_is_one_clear_line(file: Path, tmp_path: Path, share: float) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    with pytest.raises(RecordingError, match=r"cut\.mcap was cut off or is damaged: record it again") as caught:
        read(cut)
    assert "\n" not in str(caught.value)


def test_a_flipped_byte_is_noticed(file: Path, tmp_path: Path) -> None:
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "flipped.mcap").write_bytes(data)
    with pytest.raises(RecordingError, match="damaged"):
        read(tmp_path / "flipped.mcap")
    with pytest.raises(RecordingError, match="there is no recording"):
        read(tmp_path / "nowhere.mcap")


def test_methods_are_laid_over_each_other_on_one_scene_only(recording: Recording) -> None:
    one = dataclasses.replace(recording, traces=recording.traces[:1])
    assert [t.method for t in merge([one, one, one]).traces] == ["ours", "ours (2)", "ours (3)"]
    elsewhere = dataclasses.replace(one, scene=dataclasses.replace(one.scene, episode=8))
    with pytest.raises(RecordingError, match="different scenes"):
        merge([one, elsewhere])


def test_hits_are_latched(recording: Recording) -> None:
    hit = recording.traces[1].hit(recording.scene)
    assert hit[:61].sum() == 0 and hit[61:, 1].all() and not hit[:, [0, 2]].any()


def test_page_stands_alone_and_its_data_parse(recording: Recording) -> None:
    text = page.render(recording)
    assert not re.search(r"https?:|//[a-z]+\.[a-z]", re.sub(r"base64,[A-Za-z0-9+/=]+", "", text))
    assert "@" not in re.sub(r"base64,[A-Za-z0-9+/=]+|@media", "", text)
    data = json.loads(re.search(r'id="recording">(.*?)</script>', text, re.DOTALL)[1])
    assert [method["name"] for method in data["methods"]] == NAMES
    first = np.array(data["methods"][0]["position"]).reshape(-1, 3, 3) / 1000
    assert np.abs(first - recording.traces[0].position[::2]).max() <= 0.0005
    assert data["methods"][1]["verdict"] == "was hit by a ball after 1.2 s, FM 0.30 m"
    assert {"three", "formctl/player"} <= set(json.loads(re.search(r'importmap">(.*?)</script>', text)[1])["imports"])


def test_the_shipped_layout_names_real_topics(file: Path) -> None:
    stored = json.loads((page.VIEWER.parent / "foxglove_layout.json").read_text())
    with file.open("rb") as stream:
        topics = {channel.topic for channel in make_reader(stream).get_summary().channels.values()}
    used = {t for t in re.findall(r'"(/[\w/]+)', json.dumps(stored)) if not re.match(r"/method[34]", t)}
    assert used and used <= topics


def test_behaviour_shows_every_method_around_the_obstacles(recording: Recording) -> None:
    figure = draw_behaviour(recording, "stamp", ["Ours, MAPPO", "Other"])
    assert [axes.get_title(loc="left") for axes in figure.axes[::2]] == ["Ours, MAPPO", "Other"]
    assert [axes.name for axes in figure.axes] == ["rectilinear", "3d"] * 2
    data = behaviour_data(recording)
    assert set(data["method"]) == set(NAMES) and set(data["body"]) == {"drone 0", "drone 1", "drone 2", "ball 0"}
    low, high = span([flight_of(recording, t) for t in recording.traces])
    assert low <= 0 and high >= 5


def test_a_trail_is_drawn_and_listed_as_finely_as_can_be_seen(tmp_path: Path) -> None:
    times = np.arange(0, 18.001, 0.002)  # 500 Hz
    path = np.stack((np.sin(1.5 * times), 2 * times, 1.5 + 0 * times), -1)
    slots = np.array([[1.0, 0, 0], [-0.5, 0.87, 0], [-0.5, -0.87, 0]])
    flight = DrawnFlight(times, path[:, None] + slots, np.array([[0.0, 9.0]]), np.full((len(times), 0, 3), np.nan))
    kept = topview.samples(flight.times)
    assert len(kept) == 181 and (kept[0], kept[-1]) == (0, 9000)
    drawn = np.stack([np.interp(times, times[kept], path[kept, axis]) for axis in range(3)], -1)
    assert np.abs(drawn - path).max() < 0.006
    pieces, colors = topview.strokes(path[kept], "#000000", 0.4)
    assert all((one[-1] == other[0]).all() for one, other in itertools.pairwise(pieces))
    assert np.diff(colors, axis=0).min() > -0.01 and colors[0] == pytest.approx(0.6) and not colors[-1].any()
    data = topview.flight_data(flight)
    assert len(data) == 3 * 181 and len(data.to_csv(index=False)) < 40 * len(data)
    figure = topview.draw_topview(flight)
    figure.savefig(tmp_path / "flight.pdf")
    assert (tmp_path / "flight.pdf").stat().st_size < 60_000


def test_a_picture_lists_what_it_shows(recording: Recording) -> None:
    flights = [flight_of(recording, trace) for trace in recording.traces]
    low, high = shown(flights)
    data = behaviour_data(recording)
    assert low <= data["y"].min() and data["y"].max() <= high
    assert data.groupby(["method", "body"]).size().max() == 21
    numbers = data[["time", "x", "y", "z"]]
    assert numbers.equals(numbers.round(3))


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
@pytest.mark.parametrize(("choice", "view"), [("t=1.5", r"View[23]D"), ("view=2d&t=1.5", "View2D")])
def test_a_browser_runs_the_page(recording: Recording, tmp_path: Path, choice: str, view: str) -> None:
    path = tmp_path / "page.html"
    path.write_text(page.render(recording))
    flags = "--headless --no-sandbox --disable-gpu --disable-background-networking --virtual-time-budget=1500".split()
    command = [str(CHROMIUM), *flags, f"--user-data-dir={tmp_path}", "--dump-dom", f"{path.as_uri()}#{choice}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert re.search(f'data-ready="{view}"', done.stdout)
    assert "1.50 / 2 s" in done.stdout and "was hit by a ball" in done.stdout
    assert done.stdout.count('class="contact"') == 1


def test_a_recording_thinned_to_a_longer_period() -> None:
    whole = Recording(scene(), (trace("a", True, 3),), {})
    period = whole.scene.period
    thin = whole.sampled(2 * period)
    (before,), (after,) = whole.traces, thin.traces
    assert thin.scene.period == 2 * period and thin.takes_place_in(dataclasses.replace(scene(), period=2 * period))
    assert np.array_equal(after.position, before.position[::2][: len(after.position)])
    assert after.gap[0] == pytest.approx(before.gap[:2].min(0))
    assert after.reward[0] == pytest.approx(before.reward[:2].sum(0))
    assert after.formation_error[0] == pytest.approx(before.formation_error[:2].mean())
    with pytest.raises(RecordingError, match="cannot be thinned"):
        whole.sampled(1.5 * period)
