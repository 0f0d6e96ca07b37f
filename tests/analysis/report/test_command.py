"""``formctl report`` as it is typed: exit codes, what is printed, and where the report goes."""

import json
from pathlib import Path

import pytest

from analysis import stats
from formctl import cli
from tests.analysis.synthetic import Made, episodes


def typed(capsys: pytest.CaptureFixture[str], *args: object) -> tuple[int, str, str]:
    code = cli.run(["report", *map(str, args)])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_an_empty_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = typed(capsys)
    assert (code, err) == (0, "")
    assert "not measured" in out and "0.89 [0.81, 0.94] 89/100" in out
    assert "formctl reproduce survey=paper profile=laptop" in out
    (page,) = Path("runs/report/laptop").glob("*/report.html")
    assert out.splitlines()[-1] == f"report: {page}"
    record = json.loads((page.parent / "run.json").read_text())
    assert (record["kind"], record["status"], record["profile"], record["parents"]) == ("report", "done", "laptop", [])


def test_a_measured_store(made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    policy = made.training(log=False)
    flown = made.evaluation(made.policy(policy), episodes(40, 1.0))
    code, out, _ = typed(capsys, "--runs", made.root, "--out", tmp_path / "out")
    assert code == 0
    assert (
        "1.000 [0.912, 1.000] 40/40" in out
        and "40 episodes one seed 6 M steps reward shaped weights best of stage1" in out
    )
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert record["parents"] == [policy, flown.name]


def test_only_another_world_was_flown(made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made.evaluation(made.policy(made.training(log=False)), episodes(40, 1.0, ball_aim="box"))
    _, out, _ = typed(capsys, "--runs", made.root, "--out", tmp_path / "out")
    assert "40/40" in out


def test_problems_are_warnings(made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(7):
        folder = made.evaluation(made.baseline("hover"), episodes(5, 0.0))
        (folder / "episodes.parquet").write_bytes(b"")
    code, _, err = typed(capsys, "--runs", made.root, "--out", tmp_path / "out")
    assert code == 0
    assert err.count("is not a readable Parquet file") == 5 and "2 more" in err


def test_calls_that_are_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    for args, says in (
        (["--profile", "nope"], "--profile nope is unknown; choose one of: laptop, paper, smoke"),
        (["--runs", tmp_path / "file"], "is not a folder"),
        (["--out", tmp_path], "is not empty and holds no report"),
        (["--frobnicate"], "No such option"),
    ):
        code, _, err = typed(capsys, *args)
        assert code == 2 and says in err and len(err.splitlines()) == 1


def test_power(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = typed(capsys, "--power", "0.83,0.89")
    assert code == 0
    assert f"80%    {stats.episodes_to_separate(0.89, 0.83)}" in out.replace(",", "")
    assert "100            0.739 or lower" in out
    assert stats.episodes_to_separate(0.89, stats.separable(0.89, 100)) == pytest.approx(100, abs=1)
    for text in ("0.8", "0.8,0.8", "a,b", "0.8,1.4"):
        code, _, err = typed(capsys, "--power", text)
        assert code == 2 and "write two different rates, e.g. --power 0.89,0.83" in err
