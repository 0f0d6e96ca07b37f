"""Values as people type them: any text, checked where it is composed; faults of their own files in one line."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from formctl.settings import ConfigError, compose, config, expand_sweep, faults, manual, paths


@pytest.mark.parametrize("text", ["läufe", "a#b", "with space", "it's", "a,b", "1e3", "true", "C:\\x"])
def test_the_store_takes_any_text(text: str) -> None:
    assert compose([f"runs={text}"]).runs == Path(text)


def test_the_home_folder_is_known_where_the_shell_does_not_expand_it() -> None:
    assert compose(["runs=~/x"]).runs == Path.home() / "x"


@pytest.mark.parametrize("name", ["läufe", "1e3", "007"])
def test_names_take_any_letters_and_digits(name: str) -> None:
    assert compose([f"name={name}"]).name == name


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["name=a/b"], "name='a/b' cannot name a folder"),
        (["seed=-1"], "seed=-1 cannot be used: it should be greater than or equal to 0"),
        (["seed=läuf"], 'seed="läuf" cannot be used: it should be a valid integer'),
        (["scenario.start=[0,1"], "cannot read 'scenario.start=[0,1': write KEY=VALUE"),
        (["scenario.formation=[[0,0],[0,0],[2,0]]"], "puts two drones 0 m apart"),
        (["scenario.formation=none.csv"], "scenario.formation=none.csv cannot be read: no such file"),
    ],
)
def test_values_are_checked_where_they_are_composed(words: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=r"^[^\n]*$") as caught:
        compose(words)
    assert message in str(caught.value)


@pytest.mark.parametrize("text", ["algo.gamma=interval(0.1,1)", "scenario=glob(*)", "seed=range(0,3),7"])
def test_sweeps_that_do_not_work_say_which_do(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^cannot sweep over .*: -m takes lists \(seed=0,1,2\)"):
        expand_sweep([text])


def test_points_in_the_plane_and_in_a_file(tmp_path: Path) -> None:
    points = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.5, 1.0, 0.0))
    assert compose(["scenario.formation=[[0,0],[1,0],[0.5,1]]"]).scenario.formation == points
    (tmp_path / "wedge.csv").write_text("x,y\n0,0\n1,0\n0.5,1\n")
    assert compose([f"scenario.formation={tmp_path / 'wedge.csv'}"]).scenario.formation == points
    (tmp_path / "bad.csv").write_text("0,0\n1,here\n")
    with pytest.raises(ConfigError, match=r"bad\.csv, line 2: write x,y or x,y,z in m"):
        compose([f"scenario.formation={tmp_path / 'bad.csv'}"])


@pytest.fixture
def own_conf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A copy of ``conf/`` to break."""
    folder = Path(shutil.copytree(paths.conf_dir(), tmp_path / "conf"))
    for module in (config, faults, manual, paths):
        monkeypatch.setattr(module, "conf_dir", lambda: folder)
    config._composed.cache_clear()
    yield folder
    config._composed.cache_clear()


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"# A scene.\nname: x\nballs:\t\t1 # tab\n\tcolumns: 3\n", "line 3"),
        (b"# A scene.\nballs: 1\nballs: 2\n", "line 3"),
        (b"# A scene.\nstart: [0, 1\n", "line 3"),
        ("# Eine Bühne.\nname: bühne\n".encode("latin-1"), "line 1: is not UTF-8 text"),
    ],
)
def test_a_fault_in_a_file_is_one_line_and_harms_no_other_key(own_conf: Path, content: bytes, line: str) -> None:
    (own_conf / "scenario" / "x.yaml").write_bytes(content)
    with pytest.raises(ConfigError, match=r"^[^\n]*$") as caught:
        compose(["scenario=x"])
    assert f"{own_conf / 'scenario' / 'x.yaml'}, {line}" in str(caught.value)
    assert manual.explain("scenario", "mixed")["columns"]
