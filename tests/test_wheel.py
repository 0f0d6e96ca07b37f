"""The wheel, in a clean environment and an empty folder: complete, found by the program, and enough to fly."""

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from formctl import __version__
from formctl.settings import conf_dir

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from this checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--wheel-dir", folder, ROOT], check=True)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bin folder of a new environment that holds the wheel and sees the dependencies of this one."""
    home = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(home)}))
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [sys.executable, "-m", "pip", "--python", home / "bin" / "python", "install", "--quiet", "--no-deps"]
    subprocess.run([*pip, "--force-reinstall", "--no-index", wheel], check=True)
    return home / "bin"


def run(installed: Path, folder: Path, *args: str) -> str:
    """Run the installed program from ``folder`` and return what it printed."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    command = [installed / "formctl", *args]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_holds_the_packages_and_every_setting(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    assert {name.split("/")[0] for name in names} == {
        "formctl",
        "envs",
        "algos",
        "baselines",
        "analysis",
        f"formctl-{__version__}.dist-info",
    }
    extra = ("viewer/vendor/three.module.min.js", "viewer/vendor/LICENSE", "viewer/index.html", "foxglove_layout.json")
    assert {*(f"analysis/recordings/{name}" for name in extra), "formctl/policies/mixed.pt"} <= set(names)
    shipped = {name.removeprefix("formctl/_conf/") for name in names if name.startswith("formctl/_conf/")}
    assert shipped == {str(path.relative_to(conf_dir())) for path in conf_dir().rglob("*.yaml")}


def test_the_program_is_the_installed_one(installed: Path, tmp_path: Path) -> None:
    assert run(installed, tmp_path, "--version") == f"formctl {__version__}\n"
    place = [installed / "python", "-c", "import formctl, envs; print(formctl.__file__, envs.__file__)"]
    files = subprocess.run(place, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.split()
    assert all(Path(file).is_relative_to(installed.parent) for file in files)


def test_settings_are_found_in_the_wheel(installed: Path, tmp_path: Path) -> None:
    assert "name: three_period" in run(installed, tmp_path, "conf", "show")


def test_the_demo_flies_from_an_empty_folder(installed: Path, tmp_path: Path) -> None:
    assert "picture: formctl-demo.png" in run(installed, tmp_path, "demo", "eval.seconds=4")
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["formctl-demo.html", "formctl-demo.mcap", "formctl-demo.png"]
    assert "importmap" in (tmp_path / "formctl-demo.html").read_text()
    assert (tmp_path / "formctl-demo.png").read_bytes().startswith(b"\x89PNG")
