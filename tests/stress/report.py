"""How long `formctl report` takes: an empty store, and one of some 200,000 episodes in which every cell was measured.

python tests/stress/report.py FOLDER    FOLDER becomes the two stores and their reports
"""

import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

ROWS = 200_000


def fill(runs: Path) -> int:
    """Made-up episodes, as many in every cell, about ``ROWS`` in all; returns how many."""
    from tests.analysis.synthetic import full_store

    full_store(runs / "probe", count=100)
    full_store(runs / "full", count=-(-100 * ROWS // rows(runs / "probe")))
    return rows(runs / "full")


def rows(store: Path) -> int:
    import pyarrow.parquet as pq

    return sum(pq.read_metadata(path).num_rows for path in store.glob("eval/*/*/episodes.parquet"))


def timed(runs: Path) -> float:
    """Seconds of one report, the interpreter's start included."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    began = time.perf_counter()
    call = [sys.executable, "-m", "formctl", "report", "--runs", str(runs)]
    subprocess.run(call, env=environment, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began


def main(folder: Path) -> None:
    empty = folder / "empty"
    empty.mkdir(parents=True)
    print(f"an empty store: {timed(empty):.1f} s")
    count = fill(folder)
    print(f"{count:,} episodes: {timed(folder / 'full'):.1f} s")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
