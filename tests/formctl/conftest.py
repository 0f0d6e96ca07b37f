"""The command line in this process, on budgets of seconds."""

import contextlib
import io
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from formctl import cli, store

TINY = [
    "profile=smoke",
    "engine.jobs=1",
    "algo=mappo_fast",
    "reward=shaped",
    "logger=none",
    "algo.envs=8",
    "algo.rollout=4",
    "algo.epochs=1",
    "algo.minibatches=2",
    "algo.pool=16",
    "train.steps=160",
    "train.judge_episodes=2",
    "search.steps=64",
    "search.trials=2",
    "search.episodes=3",
    "search.fresh_episodes=4",
    "eval.episodes=3",
    "eval.seconds=0.5",
    "eval.time_limit=0.4",
]
"""Overrides that keep every stage and make each of them last about a second; one update is 32 steps."""


@dataclass(frozen=True)
class Answer:
    """What a call gave: exit code and what it printed."""

    code: int
    out: str
    err: str

    @property
    def line(self) -> str:
        """The one error line. Fails the test when there is none, more than one, or a traceback."""
        assert self.err.count("\n") == 1, self.err
        assert self.err.startswith("formctl: ")
        return self.err.removeprefix("formctl: ").rstrip("\n")


Call = Callable[..., Answer]


def run(*words: str) -> Answer:
    """Run one command line in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = cli.run(list(words))
    return Answer(code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="session")
def call() -> Call:
    """Run a command line exactly as given."""
    return run


@pytest.fixture
def tiny() -> list[str]:
    return list(TINY)


@pytest.fixture(scope="session")
def tiny_words() -> tuple[str, ...]:
    """The same for fixtures that outlive a test."""
    return tuple(TINY)


@pytest.fixture
def formctl(tmp_path: Path) -> Call:
    """Run a composing command on the tiny budgets in an empty store."""
    return lambda command, *words: run(command, *TINY, f"runs={tmp_path}", *words)


@pytest.fixture
def formctl_stocked(stocked: Path) -> Call:
    """The same in the stocked store."""
    return lambda command, *words: run(command, *TINY, f"runs={stocked}", *words)


@pytest.fixture(scope="session")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with a finished search ``stage1`` and a training ``ours``; for copying only."""
    root = tmp_path_factory.mktemp("stock")
    for words in (["search"], ["train", "name=ours", "weights=@stage1/best"]):
        answer = run(*words, *TINY, f"runs={root}")
        assert answer.code == 0, answer.err
    return root


@pytest.fixture(scope="module")
def stocked(stock: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A module's own copy of that store."""
    return Path(shutil.copytree(stock, tmp_path_factory.mktemp("stocked"), dirs_exist_ok=True))


@pytest.fixture
def only(tmp_path: Path) -> Callable[[str], store.Run]:
    """The only run of a kind in the test's store."""

    def find(kind: str) -> store.Run:
        (run,) = store.scan(tmp_path, kind=kind)
        return run

    return find
