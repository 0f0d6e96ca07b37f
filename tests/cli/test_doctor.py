"""``formctl doctor``: what it looks at and when it calls something broken."""

from collections import namedtuple
from collections.abc import Callable
from pathlib import Path

import pytest

from formctl import doctor
from tests.cli.conftest import Result


@pytest.fixture(autouse=True)
def no_graphics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing is probed in processes that import MuJoCo: once is enough, see the last test."""
    monkeypatch.setattr(doctor, "GL_PROBE", "")


def detail(subject: str, runs: Path) -> tuple[str, str]:
    (finding,) = (finding for finding in doctor.examine(runs) if finding.subject == subject)
    return finding.state, finding.detail


def test_a_sound_machine_passes(formctl: Callable[..., Result]) -> None:
    result = formctl("doctor")
    assert result.code == 0
    subjects = [line.split("  ")[0] for line in result.out.splitlines()]
    for subject in ("formctl", "python", "package names", "compiler", "output store", "disk", "torch", "drawing"):
        assert subject in subjects


def test_a_store_that_cannot_be_written_is_broken(formctl: Callable[..., Result], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = formctl("doctor", "runs=/proc/nowhere")
    assert result.code == 1
    assert "/proc/nowhere cannot be written" in result.out
    assert "choose another with runs=" in result.out


def test_a_missing_compiler_is_said_with_its_remedy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    assert detail("compiler", tmp_path) == (
        "note",
        "no g++: install one (Debian: g++) or set train.compile=false, much slower",
    )


def test_little_disk_space_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda path: usage(9, 9, 5e8))
    assert detail("disk", tmp_path) == ("note", "0.5 GB free: a laptop run with videos may need 2 GB")


def test_dependencies_outside_the_declared_range_are_broken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(doctor, "requires", lambda name: ["rich<2", "no-such-thing>=1", 'other>=3; extra == "dev"'])
    state, text = detail("dependencies", tmp_path)
    assert state == "broken"
    assert "rich" in text and "is not <2" in text
    assert "no-such-thing>=1 is missing" in text
    assert "other" not in text


def test_no_graphics_names_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(doctor, "GL_PROBE", "raise SystemExit(1)")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    assert detail("drawing", tmp_path) == (
        "note",
        "no pictures or videos from MuJoCo: install libegl1 libegl-mesa0 libgl1-mesa-dri (MUJOCO_GL=egl) "
        "or libosmesa6 (MUJOCO_GL=osmesa)",
    )
