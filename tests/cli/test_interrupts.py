"""Neither a closed pipe nor a closed terminal decides what is done; every request to stop is heard once."""

import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from formctl import interrupts

ROOT = Path(__file__).parents[2]


def test_what_is_told_to_nobody_is_no_error() -> None:
    reading, writing = os.pipe()
    audience = interrupts.Audience(os.fdopen(writing, "w"))
    audience.write("heard\n")
    audience.flush()
    assert os.read(reading, 100) == b"heard\n"
    os.close(reading)
    for _ in range(3):
        assert audience.write("unheard\n") == 8
        audience.flush()
    audience.close()  # what is left in the buffer is no error either


def test_a_terminal_that_is_gone_is_no_error() -> None:
    class Gone(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(5, "Input/output error")

    assert interrupts.Audience(Gone()).write("unheard") == 7


@pytest.mark.parametrize("number", interrupts.ASKING)
def test_every_way_to_ask_for_a_stop_is_an_interrupt(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), interrupts.handled(interrupts.interrupt):
        os.kill(os.getpid(), number)
    assert signal.getsignal(number) == before


def test_what_is_ignored_stays_ignored() -> None:
    """As under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interrupts.handled(interrupts.interrupt):
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_listing_that_nobody_reads_to_its_end_is_well() -> None:
    words = [sys.executable, "-m", "formctl", "conf", "keys"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT, text=True) as listing:
        assert listing.stdout is not None and listing.stderr is not None
        listing.stdout.readline()
        listing.stdout.close()
        assert listing.stderr.read() == ""
        assert listing.wait() == 0
