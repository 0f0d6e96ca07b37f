"""A weight search under fire: real trainings of seconds, and a loop that kills its processes until the study is whole.

    python tests/stress/chaos.py sqlite --runs FOLDER    worker processes; every fifth shot hits their owner
    python tests/stress/chaos.py postgres --runs FOLDER  two hosts by name, a runs folder each, a server; needs root
    python tests/stress/chaos.py ray --runs FOLDER       a Ray cluster on this machine, its workers shot

Afterwards the study must hold exactly the trials that were asked for, complete, none twice, with the weights and the
outcomes of an undisturbed run (``--compare FOLDER`` names one, otherwise it is made first; ``--compare none`` compares
the weights with what the study's seed and the trials' numbers say, and no outcomes).
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

WEIGHTS = ("w_formation", "w_flight", "w_obstacle", "w_action")

TINY = [
    "profile=smoke",
    "algo=mappo_fast",
    "reward=shaped",
    "logger=none",
    "encoder.width=8",
    "encoder.heads=1",
    "encoder.initialisation=default",
    "algo.envs=16",
    "algo.rollout=8",
    "algo.epochs=1",
    "algo.minibatches=2",
    "algo.pool=32",
    "train.checkpoint_minutes=0.005",
    "search.steps=256",
    "search.episodes=4",
    "search.fresh_episodes=8",
    "search.lease_minutes=3.0",
    "eval.seconds=0.5",
    "eval.time_limit=0.4",
]
"""Two updates of 128 steps and four short episodes per trial, a checkpoint every 0.3 s."""

FAR = "far-away"
"""Name of the second host."""

Running = dict[tuple[str, ...], "subprocess.Popen[bytes]"]
"""Searches at work, by the words of their calls."""


def start(log: Path, *words: str) -> "subprocess.Popen[bytes]":
    """``formctl search`` in the background, its output appended to ``log``; a worker of a study is on another host."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    call = [sys.executable, "-m", "formctl", "search", *words]
    if "--worker" in words:
        call = ["unshare", "--uts", "sh", "-c", f'hostname {FAR} && exec "$@"', "sh", *call]
    with log.open("ab") as file:
        return subprocess.Popen(call, env=environment, stdout=file, stderr=file, start_new_session=True)


def children(pid: int) -> list[int]:
    """Child processes of ``pid``."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


def named(pid: int, text: str) -> bool:
    """Whether the command line of ``pid`` contains ``text``."""
    try:
        return text in Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace")
    except OSError:
        return False


def workers(owner: int, engine: str) -> list[int]:
    """Processes that run trials for ``owner``."""
    servers = [child for child in children(owner) if engine == "ray" or named(child, "forkserver")]
    below = [pid for child in servers for pid in children(child)]
    if engine == "ray":
        deeper = [pid for child in below for pid in children(child)]
        return [pid for pid in (*below, *deeper) if named(pid, "ray::_task")]
    return below


def begun(address: str, trials: int) -> None:
    """Wait until the study is to have all its trials: a worker that joins before would leave again."""
    from formctl.search import database
    from formctl.search.study import WeightStudy

    study = WeightStudy(Path(), database.read(address), "stage1")
    while study.total() < trials:
        time.sleep(0.5)
    study.close()


def kill(pid: int) -> bool:
    """SIGKILL; False where there is no such process any more."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def shoot(running: Running, log: Path, every: float, engine: str, owners: int) -> dict[str, int]:
    """Until all calls have ended well kill a random worker, and an owner at each ``owners``-th shot; what was killed is
    begun again. A shot comes up to ``every`` s after a trial has finished, at random (at once, it would always meet the
    other worker's trial): a busy machine would fail trials for killing all their workers, as it should."""
    chance, shots = random.Random(0), {"workers": 0, "owners": 0}
    due: float | None = time.monotonic() + every
    finished = 0
    while running:
        time.sleep(0.2)
        for call, process in list(running.items()):
            code = process.poll()
            if code == 0:
                del running[call]
            elif code is not None:
                assert code == -signal.SIGKILL, f"ended with {code}; see {log}"
                running[call] = start(log, *call)
        targets = [pid for process in running.values() for pid in workers(process.pid, engine)]
        done = log.read_bytes().count(b": SR ")
        if due is None and done > finished:
            due, finished = time.monotonic() + chance.uniform(0, every), done
        if due is None or time.monotonic() < due or not targets:
            continue
        due = None
        count = shots["workers"] + shots["owners"] + 1
        if owners and count % owners == 0:
            shots["owners"] += kill(chance.choice(list(running.values())).pid)
        else:
            shots["workers"] += kill(chance.choice(targets))
    return shots


def rows(runs: Path, url: str | None) -> tuple[list[dict[str, object]], int]:
    """The study's trials as its database has them, and how many leases were lost."""
    from formctl.search import database, table
    from formctl.search.study import WeightStudy

    (folder,) = (runs / "search" / "stage1").iterdir()
    study = WeightStudy(
        folder, database.read(url) if url else database.sqlite(folder / "study.db"), "stage1" if url else table.NAME
    )
    kept = study.in_optuna().trials
    assert {trial.state.name for trial in kept} == {"COMPLETE"}, [trial.state.name for trial in kept]
    found = sorted((table.row(trial) for trial in kept), key=lambda row: row["trial"])
    assert all(row.token is None for row in study.leases.rows())
    return found, study.leases.losses()


@contextmanager
def shared() -> Iterator[str]:
    from tests import postgres

    if reason := postgres.missing():
        sys.exit(f"not run: {reason}")
    with postgres.server() as address:
        yield address


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("store", choices=("sqlite", "postgres", "ray"))
    options.add_argument("--runs", type=Path, required=True, help="an empty folder")
    options.add_argument("--trials", type=int, default=64)
    options.add_argument("--every", type=float, default=4.0, help="longest wait in s from trial to shot")
    options.add_argument("--owners", type=int, default=5, help="every n-th shot hits an owner; 0 for none")
    options.add_argument("--compare", type=Path, help="runs folder of an undisturbed search")
    asked = options.parse_args()
    asked.runs.mkdir(parents=True, exist_ok=True)
    log = asked.runs / "chaos.log"
    common = [*TINY, f"search.trials={asked.trials}"]
    calm = asked.compare or asked.runs / "undisturbed"
    weighed = str(asked.compare) == "none"
    if not weighed and not calm.exists():
        since = time.monotonic()
        assert start(log, *common, "engine.jobs=2", f"runs={calm}").wait() == 0, f"see {log}"
        print(f"undisturbed: {asked.trials} trials in {time.monotonic() - since:.0f} s", flush=True)
    stormy = asked.runs / "disturbed"
    with shared() if asked.store == "postgres" else nullcontext() as address:
        engine = ("engine=ray", "engine.address=local") if asked.store == "ray" else ("engine=local",)
        near = (*common, *engine, "engine.jobs=2", f"runs={stormy}")
        if address:
            os.environ["FORMCTL_STORAGE"] = address
            assert start(log, *near, "search.trials=1").wait() == 0, f"see {log}"
        since = time.monotonic()
        running: Running = {near: start(log, *near)}
        if address:
            begun(address, asked.trials)
            far = ("--worker", "stage1", f"runs={asked.runs / 'elsewhere'}", "engine.jobs=2")
            running[far] = start(log, *far)
        shots = shoot(running, log, asked.every, asked.store, asked.owners if asked.store != "ray" else 0)
        seconds = time.monotonic() - since
        found, losses = rows(stormy, address)
    expected = by_law(asked.trials) if weighed else rows(calm, None)[0]
    compare(found, expected, asked.trials)
    print(f"{asked.store}: {asked.trials} trials in {seconds:.0f} s under fire")
    print(f"killed: {shots['workers']} workers, {shots['owners']} owners; leases reclaimed: {losses}")
    print("trials finished by host:", dict(Counter(str(row["host"]) for row in found)))
    same = (
        "weights are those of the seed and the number" if weighed else "weights and outcomes are the undisturbed run's"
    )
    print(f"none running, none lost, none twice; {same}")


def compare(found: list[dict[str, object]], calm: list[dict[str, object]], trials: int) -> None:
    """Fail unless both studies hold the same trials, all complete."""
    assert [row["trial"] for row in found] == list(range(trials)), [row["trial"] for row in found]
    assert {row["state"] for row in found} == {"done"}
    keys = [key for key in (*WEIGHTS, "sr", "sr_k", "sr_n", "cfr", "fm", "steps", "budget") if key in calm[0]]
    assert [[row[key] for key in keys] for row in found] == [[row[key] for key in keys] for row in calm]
    assert len({tuple(row[key] for key in WEIGHTS) for row in found}) == trials


def by_law(trials: int) -> list[dict[str, object]]:
    """What an undisturbed study of seed 0 hands out."""
    from formctl.search.laws import weights

    return [dict(zip(WEIGHTS, weights(0, number, "dirichlet"), strict=True)) for number in range(trials)]


if __name__ == "__main__":
    main()
