"""The engine's seam: order, notes, errors and interrupts."""

import pytest

from formctl.engines.engine import InProcess
from formctl.store.compare import differences, fingerprint


def double(request, emit):
    emit({"at": request})
    if request == 2:
        raise ValueError("two")
    return 2 * request


def test_one_process_runs_everything_in_order_and_hands_errors_over():
    heard = []
    drawn = []

    def draw():
        drawn.append(len(drawn))
        return drawn[-1] if drawn[-1] < 4 else None

    finished = []
    for item in InProcess().run(double, draw, lambda request, note: heard.append((request, note["at"]))):
        finished.append((item.request, item.result, str(item.error) if item.error else None))
        assert drawn[-1] == item.request  # nothing is drawn before there is room for it
    assert finished == [(0, 0, None), (1, 2, None), (2, None, "two"), (3, 6, None)]
    assert heard == [(number, number) for number in range(4)]


def test_interrupts_end_the_whole():
    def stop(request, emit):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(InProcess().run(stop, iter([1, 2]).__next__, lambda request, note: None))


def test_differences_and_fingerprints():
    one = {"a": {"b": 1, "c": (1, 2)}, "d": None}
    assert fingerprint(one) == fingerprint({"d": None, "a": {"c": [1, 2], "b": 1}})
    assert fingerprint(one) != fingerprint({**one, "d": 0})
    assert differences(one, {"a": {"b": 2, "c": [1, 2]}, "e": 1}) == {
        "a.b": (1, 2),
        "d": (None, "(absent)"),
        "e": ("(absent)", 1),
    }
