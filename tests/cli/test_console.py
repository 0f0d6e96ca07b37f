"""Progress and tables where there is no terminal, and the arithmetic of speed and time left."""

import pytest

from formctl import console


class Clock:
    """A clock that the test turns."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_speed_and_time_left() -> None:
    clock = Clock()
    meter = console.Meter(total=1000, clock=clock)
    assert meter.text("steps") == "0 of 1,000 steps"
    clock.now = 100  # compiling
    meter.update(100)
    assert meter.text("steps") == "100 of 1,000 steps"
    clock.now = 110
    meter.update(300)
    assert meter.text("steps") == "300 of 1,000 steps, 20 steps/s, 35 s left"


def test_a_slow_start_is_forgotten_after_a_minute() -> None:
    clock = Clock()
    meter = console.Meter(total=10_000, clock=clock)
    for clock.now, done in ((100, 1), (110, 1001), (150, 5001), (170, 7001)):
        meter.update(done)
    assert meter.speed == pytest.approx(100)


def test_what_comes_in_bursts_is_averaged() -> None:
    """Ten episodes at a time, 70 s apart: whether the first or the last of ten has just been told hardly matters."""
    clock = Clock()
    meter = console.Meter(total=1000, clock=clock)
    for burst in range(1, 21):
        clock.now = 70 * burst
        for done in range(10 * burst - 9, 10 * burst + 1):
            meter.update(done)
            assert burst < 12 or meter.speed == pytest.approx(10 / 70, rel=0.3)


def test_a_resumed_task_counts_only_what_it_did_itself() -> None:
    clock = Clock()
    meter = console.Meter(total=100, start=50, clock=clock)
    for clock.now, done in ((0, 50), (10, 60)):
        meter.update(done)
    assert meter.text("trials") == "60 of 100 trials, 1 trials/s, 40 s left"


def test_slow_things_are_told_in_time_each() -> None:
    clock = Clock()
    meter = console.Meter(total=4, clock=clock)
    for clock.now, done in ((0, 0), (200, 1)):
        meter.update(done)
    assert meter.text("trials") == "1 of 4 trials, 3 min each, 10 min left"


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0 s"), (89, "89 s"), (90, "2 min"), (3600, "60 min"), (11_100, "3 h 05 min")]
)
def test_durations(seconds: float, text: str) -> None:
    assert console.duration(seconds) == text


def test_plain_progress_speaks_every_ten_seconds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = Clock()
    monkeypatch.setattr(console.time, "monotonic", clock)
    monkeypatch.setattr(console.Meter.__init__, "__defaults__", (0, clock))
    with console.progress("training", 100) as bar:
        for clock.now in range(1, 26):
            bar.update(4 * clock.now, "period static")
    assert capsys.readouterr().out == (
        "training: 40 of 100 steps, 4 steps/s, 15 s left, period static\n"
        "training: 80 of 100 steps, 4 steps/s, 5 s left, period static\n"
    )


def test_a_table_without_a_terminal_is_aligned_and_never_cut(capsys: pytest.CaptureFixture[str]) -> None:
    console.table(("method", "cfr"), [("a" * 120, 0.5), ("[b]", 1)], title="Mixed")
    assert capsys.readouterr().out == f"Mixed\n{'method':120}  cfr\n{'a' * 120}  0.5\n{'[b]':120}  1\n"


def test_a_bar_on_a_terminal_nests_and_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = console.Console(force_terminal=True, record=True, width=120)
    monkeypatch.setattr(console, "out", terminal)
    with console.progress("search", 2, "trials") as outer:
        with console.progress("training [x]", 10) as inner:
            inner.update(5, "[note]")
        outer.advance()
        assert console._live is not None
        assert [task.description for task in console._live.tasks] == ["search"]
        assert console._live.tasks[0].completed == 1
    assert console._live is None


def test_track_passes_every_item_on() -> None:
    assert list(console.track([3, 1, 2], "flying", "episodes")) == [3, 1, 2]


def test_no_time_left_is_made_from_preparations(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = Clock()
    monkeypatch.setattr(console.time, "monotonic", clock)
    monkeypatch.setattr(console.Meter.__init__, "__defaults__", (0, clock))
    with console.progress("training", 1000) as bar:
        for clock.now, ready in ((5, 0), (6, 1), (100, 2)):
            bar.preparing(f"compiling, {ready} of 3 ready")
        for clock.now, done in ((200, 10), (210, 110), (220, 210)):
            bar.update(done)
    assert capsys.readouterr().out == (
        "training: compiling, 0 of 3 ready\n"
        "training: compiling, 2 of 3 ready\n"
        "training: 10 of 1,000 steps\n"
        "training: 110 of 1,000 steps, 10 steps/s, 89 s left\n"
        "training: 210 of 1,000 steps, 10 steps/s, 79 s left\n"
    )
