"""Recordings for the Rerun viewer: its own checker reads them, and everything is in them."""

import subprocess
import sys
from pathlib import Path

import pytest

from analysis.recordings import Recording, merge
from tests.analysis.recordings.test_recordings import scene, trace

rerun_writer = pytest.importorskip("analysis.recordings.rerun_writer")


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two methods on one scene."""
    recordings = [
        Recording(scene(), (trace(name, hit, seed=1),), {}) for name, hit in (("ours", False), ("R MADER", True))
    ]
    return rerun_writer.write(merge(recordings), tmp_path_factory.mktemp("rerun") / "flight.rrd")


def rrd(*words: str) -> str:
    """What the viewer's own program says of a file."""
    program = Path(sys.executable).with_name("rerun")
    done = subprocess.run([program, "rrd", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_rerun_s_own_checker_reads_it(file: Path) -> None:
    rrd("verify", str(file))


def test_everything_is_in_it(file: Path) -> None:
    chunks = rrd("print", str(file))
    for entity in ("/world/columns", "/world/ours/drone0", "/world/R_MADER/drone2", "/plots/ours/reward/obstacle"):
        assert entity in chunks
    assert "/plots/R_MADER/formation_error" in chunks and "/ours/events" in chunks
