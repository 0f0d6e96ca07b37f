"""One more process of a training (``formctl.processes``): ``python -m formctl.replica PORT RANK SIZE``."""

import signal
import sys
from contextlib import suppress
from datetime import timedelta

import torch
import torch.distributed as dist

from algos.replicas import ReplicaLost, Replicas
from algos.trainer import follow


def main(port: int, rank: int, size: int) -> None:
    """Learn with the processes that meet at ``port``, until rank 0 ends the training or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # rank 0 decides when to stop
    torch.set_num_threads(1)
    store = dist.TCPStore("127.0.0.1", port, is_master=False, timeout=timedelta(minutes=5))
    store.set(f"started/{rank}", "")
    with suppress(ReplicaLost):
        replicas = Replicas.join(rank, size, store)
        follow(replicas)
        replicas.leave()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:4]))
