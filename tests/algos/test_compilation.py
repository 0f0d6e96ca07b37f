"""Compiling: where code is kept, what is said meanwhile, how it ends when it fails or is interrupted."""

import logging
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch._inductor.exc import CppCompileError

from algos import compilation
from algos.compilation import Compiler
from envs import native


@pytest.fixture
def no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if nobody had chosen a cache yet."""
    monkeypatch.delenv("TORCHINDUCTOR_CACHE_DIR", raising=False)
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", "")  # so that it is put back afterwards, whatever is set meanwhile
    monkeypatch.delenv("TORCHINDUCTOR_CACHE_DIR")


@pytest.mark.usefixtures("no_cache")
def test_compiled_code_lasts_in_the_users_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    Compiler(True)
    folder = Path(os.environ["TORCHINDUCTOR_CACHE_DIR"])
    assert folder.is_dir() and folder.parent == tmp_path / "formctl" and torch.__version__ in folder.name
    monkeypatch.setattr(native, "processor", lambda: "another")
    del os.environ["TORCHINDUCTOR_CACHE_DIR"]
    assert compilation.cache_folder() != folder, "another processor's code is not loaded"


@pytest.mark.usefixtures("no_cache")
def test_a_cache_that_was_chosen_or_cannot_be_made_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    compilation.use_cache()
    assert "TORCHINDUCTOR_CACHE_DIR" not in os.environ
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path / "mine"))
    compilation.use_cache()
    assert compilation.cache_folder() == tmp_path / "mine"


def pretend(monkeypatch: pytest.MonkeyPatch, compiled: Callable[..., Any]) -> None:
    """Let `torch.compile` return `compiled`."""
    monkeypatch.setattr(torch, "compile", lambda function, **_: compiled)


def test_every_piece_is_announced_once_before_it_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[str, int, int]] = []
    compiler = Compiler(True, lambda *news: told.append(news))
    pretend(monkeypatch, lambda x: (x, compiler.busy))
    one, two = compiler(torch.nn.Linear.forward), compiler(_private)
    assert [one(1), one(2), two(3), one(4)] == [(1, True), (2, False), (3, True), (4, False)]
    assert told == [("Linear.forward", 0, 2), ("_private", 1, 2)]


def _private(x: int) -> int:
    return x


def test_thousands_of_lines_of_a_compiler_become_one(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(x: int) -> int:
        raise CppCompileError(["g++", "x.cpp"], 2000 * "note: and so on\n")

    compiler = Compiler(True)
    pretend(monkeypatch, refuse)
    with caplog.at_level(logging.DEBUG, logger=compilation.log.name):
        assert compiler(_private)(3) == 3 and not compiler.enabled
    line, whole = (record.getMessage() for record in caplog.records)
    assert line.startswith("not compiled, which is several times slower: ") and len(line) < 300 and "\n" not in line
    assert len(whole) > 2000


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks for processes in /proc")
def test_an_interrupt_ends_the_compilers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fake = tmp_path / "g++"
    fake.symlink_to(sys.executable)  # what runs is looked up: the link's target counts
    names = (Path(sys.executable).resolve().name,)
    monkeypatch.setattr(compilation, "COMPILERS", names)
    waiting = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import time; time.sleep(60)'])"
    driver = subprocess.Popen([str(fake), "-c", waiting])

    def interrupted(x: int) -> int:
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
        driver.wait(30)
        return x

    compiler = Compiler(True)
    pretend(monkeypatch, interrupted)
    with pytest.raises(KeyboardInterrupt):
        compiler(_private)(3)
    assert driver.wait(5) == -signal.SIGKILL and not compiler.busy
