"""Other distributions bring packages called envs or analysis: one clear line, at start and in doctor."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from formctl import doctor, guard
from tests.cli.conftest import Result


@pytest.fixture
def intruder(tmp_path: Path) -> Path:
    """A folder with the installed distribution ``rl-envs``, which brings a package ``envs``."""
    folder = tmp_path / "elsewhere"
    (folder / "envs").mkdir(parents=True)
    (folder / "envs" / "__init__.py").touch()
    info = folder / "rl_envs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: rl-envs\nVersion: 1.0\n")
    (info / "RECORD").write_text("envs/__init__.py,,\nrl_envs-1.0.dist-info/METADATA,,\n")
    return folder


def test_windows_itself_is_told_where_to_go(monkeypatch: pytest.MonkeyPatch, formctl: Callable[..., Result]) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    result = formctl("--version")
    assert result.code == 2
    assert result.err == "formctl: formctl needs a POSIX system: on Windows run it in WSL 2, see docs/install.md\n"


def test_the_packages_are_ours_here() -> None:
    guard.check()


def test_a_distribution_that_hides_ours_is_named(intruder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(intruder)
    with pytest.raises(guard.NameClash) as error:
        guard.check()
    assert str(error.value) == (
        "distribution rl-envs brings a package 'envs' that hides formctl's own "
        f"({intruder / 'envs'}): pip uninstall rl-envs"
    )


def test_the_program_refuses_to_start_with_one_line(
    intruder: Path, monkeypatch: pytest.MonkeyPatch, formctl: Callable[..., Result]
) -> None:
    monkeypatch.syspath_prepend(intruder)
    result = formctl("conf", "show")
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith("formctl: distribution rl-envs brings a package 'envs'")
    assert result.err.count("\n") == 1


def test_a_plain_folder_of_that_name_is_named_too(tmp_path: Path) -> None:
    (tmp_path / "analysis").mkdir()
    (tmp_path / "analysis" / "__init__.py").touch()
    home = Path(guard.__file__).parents[1]
    program = f"import sys; sys.path.append({str(home)!r}); from formctl.cli import run; sys.exit(run(['--version']))"
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    folder = tmp_path / "analysis"
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        f"formctl: {folder} hides formctl's own package 'analysis': rename that folder or take it off the Python path\n"
    )


def test_doctor_sees_a_distribution_that_installs_into_our_packages(
    intruder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.rmtree(intruder / "envs")  # its file list is what counts
    monkeypatch.syspath_prepend(intruder)
    findings = [finding for finding in doctor.examine(tmp_path) if finding.subject == "package names"]
    assert [(finding.state, finding.detail) for finding in findings] == [
        ("broken", "rl-envs installs into our package 'envs': pip uninstall rl-envs")
    ]
