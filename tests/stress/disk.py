"""A disk that fills up, and a folder that may not be written any more, in the middle of a search: one line, then on.

python tests/stress/disk.py FOLDER    FOLDER becomes the place of a small file system of its own; needs root
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

TRIALS = 6


@contextmanager
def disk(folder: Path) -> Iterator[None]:
    """A file system of 40 MB at ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    mount("-t", "tmpfs", "-o", "size=40M", "tmpfs", folder)
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def mount(*words: object) -> None:
    subprocess.run(["mount", *map(str, words)], check=True)


def freeze(folder: Path, attribute: str) -> None:
    """Forbid (``+i``) even root to write below ``folder``, or allow it again (``-i``)."""
    subprocess.run(["chattr", "-R", attribute, str(folder)], check=False, capture_output=True)  # files come and go


def search(runs: Path, disturb: Callable[[], None] | None = None) -> tuple[int, str]:
    """Run the search; ``disturb`` is called as soon as two more trials are done. Returns exit code and stderr."""
    from tests.stress.chaos import TINY

    words = ["search", *TINY, f"search.trials={TRIALS}", "engine.jobs=2", f"runs={runs}"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    call = [sys.executable, "-m", "formctl", *words]
    process = subprocess.Popen(call, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stderr is not None
    done = 0
    for line in process.stdout:
        done += ": SR " in line
        if disturb is not None and done == 2:
            disturb()
            disturb = None
    process.wait()
    return process.returncode, process.stderr.read()


def show(what: str, code: int, err: str, runs: Path) -> None:
    """Say how it ended, and that the study is whole as far as it got."""
    from formctl.search.table import read_rows
    from formctl.stages.verify import problems
    from formctl.store import Run

    (folder,) = (runs / "search" / "stage1").iterdir()
    done = sum(row["state"] == "done" for row in read_rows(folder))
    damaged = list(problems(Run(folder)))
    print(f"{what}: exit {code}, {done} done, {len(damaged)} damaged files\n  {err.strip()}", flush=True)
    assert not damaged, damaged


def main() -> None:
    place = Path(sys.argv[1]).resolve()
    with disk(place):
        runs, ballast = place / "runs", place / "ballast"

        def fill() -> None:
            with ballast.open("wb", buffering=0) as file:
                try:
                    while True:
                        file.write(b"0" * 4096)
                except OSError:
                    return

        code, err = search(runs, fill)
        assert (code == 2 and err.strip().count("\n") == 0 and "make room" in err) or "full" in err, err
        ballast.unlink()
        show("full in the middle", code, err, runs)

        code, err = search(runs, lambda: freeze(runs, "+i"))
        freeze(runs, "-i")
        show("read-only in the middle", code, err, runs)
        assert code == 2 and err.strip().count("\n") == 0 and "cannot" in err, err

        begun = time.monotonic()
        code, err = search(runs)
        assert code == 0, err
        show(f"room again, {time.monotonic() - begun:.0f} s", code, err, runs)


if __name__ == "__main__":
    main()
