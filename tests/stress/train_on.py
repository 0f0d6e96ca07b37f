"""Does a shipped policy get worse when it is trained on? Minutes; exit code 1 where it does.

    python tests/stress/train_on.py mixed --steps 200000 --episodes 500

Trains on from the policy, with the settings it was trained with as far as they are given after ``--``, flies both on
one bank and compares the rows: the trained-on policy may be worse by no more than ``--margin``.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from formctl import cli


def main() -> int:
    """Exit code of the comparison, or of what failed before it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policy", help="name of a shipped policy, or a policy file")
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--episodes", type=int, default=500)
    parser.add_argument("--margin", type=float, default=0.02)
    parser.add_argument("words", nargs="*", help="settings of the training, e.g. algo=shac reward=smooth")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        store, before, after = f"runs={folder}", Path(folder) / "before.parquet", Path(folder) / "after.parquet"
        train = ["train", f"start={given.policy}", "name=on", "curriculum=none", f"train.steps={given.steps}"]
        flights = ["eval", store, f"eval.episodes={given.episodes}", "logger=none"]
        calls = [
            [*train, *given.words, store, "logger=none", "train.judge_steps=50000"],
            [*flights, "--policy", given.policy, "--out", str(before)],
            [*flights, "--policy", "on", "--out", str(after)],
            ["compare", str(before), str(after), "--margin", str(given.margin)],
        ]
        for call in calls:
            if code := cli.run(call):
                return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
