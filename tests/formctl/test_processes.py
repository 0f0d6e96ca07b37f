"""``train.processes``: one policy out of several processes, which may die, change in number, or live on other hosts."""

import os
import signal
import socket
import subprocess
import sys

import pytest

from algos import checkpoint
from formctl import processes, store
from formctl.stages import train
from tests.formctl.conftest import TINY

TWO = ("train.processes=2", "train.checkpoint_minutes=1e-9")


def policy(run):
    return checkpoint.digest(checkpoint.load(run.path / "policy.pt", kind="policy")["weights"])


@pytest.mark.timeout(900)  # six starts of Python, which take long on a busy machine
def test_a_process_that_dies_stops_the_training_and_what_it_left_goes_on(formctl, call, tmp_path, monkeypatch):
    """To the policy of a training that was left alone, tensor for tensor; under one process to another, with a note."""
    assert formctl("train", "name=alone", *TWO).code == 0
    alone = store.resolve("alone", tmp_path)
    assert alone.record["processes"] == 2
    describe, started = train.note, []
    start = processes._start
    monkeypatch.setattr(processes, "_start", lambda *where: started.append(start(*where)) or started[-1])
    steps = []

    def kill(period, metrics):
        steps.append(period)
        if len(steps) == 3:
            started[0].kill()
        return describe(period, metrics)

    monkeypatch.setattr(train, "note", kill)
    lost = formctl("train", "name=lost", *TWO)
    run = store.resolve("lost", tmp_path)
    assert lost.code == 1 and f"process {started[0].pid} was killed by SIGKILL; go on with:" in lost.line
    assert run.status == "failed" and 64 <= checkpoint.load(run.checkpoint())["steps"] <= 96
    monkeypatch.undo()
    copy = tmp_path / "train" / "copy" / "20000101T000000-0000"
    subprocess.run(["cp", "-r", "--", run.path, copy.parent.mkdir(parents=True) or copy], check=True)

    assert call("train", "--resume", run.id, f"runs={tmp_path}").code == 0
    assert run.status == "done" and policy(run) == policy(alone)

    changed = call("train", "--resume", str(copy), f"runs={tmp_path}", "train.processes=1")
    assert changed.code == 0, changed.err
    assert "1 processes went on after 2" in changed.out and store.Run(copy).record["notes"]


def test_processes_have_to_divide_the_environments(formctl):
    refused = formctl("train", "train.processes=3")
    assert refused.code == 2 and "algo.envs=8 does not divide into train.processes=3" in refused.line


@pytest.mark.parametrize(("together", "count"), [(1.9, 2), (1.1, 1)])
def test_auto_takes_as_many_as_help(formctl, only, monkeypatch, together, count):
    monkeypatch.setattr(processes, "cores", lambda: 2)
    monkeypatch.setattr(processes, "speed", lambda number: 100.0 if number == 1 else 100 * together)
    taken = []

    def replicas(number):
        taken.append(number)
        raise KeyboardInterrupt

    monkeypatch.setattr(processes, "replicas", replicas)
    answer = formctl("train", "train.processes=auto")
    assert taken == [count] and f"2 processes do {together:.2f} times the work of one" in answer.out


@pytest.mark.timeout(900)
def test_two_hosts_train_with_torchrun(tmp_path):
    """Each with its own folder and its own torchrun; the first keeps the run."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    hosts = []
    for rank in (0, 1):
        launch = ["-m", "torch.distributed.run", "--nnodes=2", f"--node-rank={rank}", "--nproc-per-node=1"]
        meet = ["--master-addr=127.0.0.1", f"--master-port={port}", "-m", "formctl", "train"]
        words = [*TINY, "train.steps=96", "curriculum=none", f"runs={tmp_path / str(rank)}"]
        environment = os.environ | {"GLOO_SOCKET_IFNAME": "lo", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        hosts.append(subprocess.Popen([sys.executable, *launch, *meet, *words], env=environment, cwd=tmp_path))
    try:
        assert [host.wait(800) for host in hosts] == [0, 0]
    finally:
        for host in hosts:
            host.send_signal(signal.SIGKILL)
            host.wait()
    (run,) = store.scan(tmp_path / "0", kind="train")
    assert run.status == "done" and run.record["processes"] == 2 and run.record["result"]["steps"] == 96
    assert not (tmp_path / "1").exists()
