"""``formctl runs``: what a user sees of the store."""

import pytest

from formctl import store


@pytest.fixture
def runs(call):
    return lambda *words: call("runs", *words)


def test_ls_lists_newest_first_and_filters(runs, stocked):
    answer = runs("ls", f"runs={stocked}", "--kind", "train")
    assert answer.code == 0
    lines = [line.split() for line in answer.out.splitlines()]
    trained = store.resolve("ours", stocked)
    assert lines[0][:4] == ["id", "kind", "name", "status"]
    assert [line[:5] for line in lines[1:]] == [[trained.id, "train", "ours", "done", "smoke"]]
    both = runs("ls", f"runs={stocked}").out.splitlines()
    assert len(both) >= 3 and ["search", "stage1", "done"] in [line.split()[1:4] for line in both]


def test_ls_says_who_flew_where(runs, formctl, tmp_path):
    assert formctl("eval", "--baseline", "hover", "scenario=static").code == 0
    (line,) = runs("ls", f"runs={tmp_path}", "--kind", "eval").out.splitlines()[1:]
    assert "hover in static: SR 0.000, CFR 0.000" in line


def test_ls_of_nothing_says_so(runs, tmp_path):
    answer = runs("ls", f"runs={tmp_path}")
    assert answer.code == 0 and f"no runs in {tmp_path}/ yet; formctl train makes one" in answer.out
    assert "that match" in runs("ls", f"runs={tmp_path}", "--kind", "eval").out
    assert f"there is no store {tmp_path}/none/" in runs("verify", "--runs", f"{tmp_path}/none").out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("ls", "--status", "finished"), "--status finished is none of created, running, done, failed, interrupted"),
        (("ls", "--kind", "training"), "--kind training is none of"),
        (("ls", "store=here"), "write runs=FOLDER"),
        (("show", "nobody"), "no run 'nobody'"),
    ],
)
def test_wrong_calls(runs, words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    answer = runs(*words)
    assert answer.code == 2 and message in answer.line


def test_a_folder_that_is_no_run_is_refused(runs, tmp_path):
    answer = runs("show", str(tmp_path))
    assert answer.code == 2 and "is not a run folder" in answer.line


def test_show_prints_record_and_files(runs, stocked):
    answer = runs("show", "ours", f"runs={stocked}")
    assert answer.code == 0
    assert "status: done" in answer.out and "checkpoints/latest.pt" in answer.out and "policy.pt" in answer.out


def test_diff_names_settings_and_results(runs, formctl, tmp_path):
    for words in (("name=a",), ("name=b", "seed=3")):
        assert formctl("train", "train.steps=96", *words).code == 0
    answer = runs("diff", "a", "b", f"runs={tmp_path}")
    lines = [line.split() for line in answer.out.splitlines()]
    assert answer.code == 0 and lines[1:3] == [["setting", "name", "a", "b"], ["setting", "seed", "0", "3"]]
    same = runs("diff", "a", "a", f"runs={tmp_path}")
    assert "same settings, results and versions" in same.out


def test_tags_are_set_found_and_taken_away(runs, formctl, tmp_path):
    assert formctl("train", "train.steps=96", "name=a").code == 0
    place = ("--runs", str(tmp_path))
    assert "paper, keep" in runs("tag", "a", "paper", "keep", *place).out
    assert len(runs("ls", f"runs={tmp_path}", "--tag", "keep").out.splitlines()) == 2
    assert "no runs in" in runs("ls", f"runs={tmp_path}", "--tag", "other").out
    assert "no tags" in runs("tag", "a", "paper", "keep", "--remove", *place).out


def test_rm_takes_what_nobody_needs(runs, stocked, tmp_path):
    import shutil

    shutil.copytree(stocked, tmp_path / "store")
    place = ("--runs", str(tmp_path / "store"))
    study, ours = (store.resolve(name, tmp_path / "store") for name in ("stage1", "ours"))
    needed = runs("rm", "stage1", "--yes", *place)
    assert needed.code == 2 and f"is still needed by train/ours/{ours.id}" in needed.line
    trial = runs("rm", str(study.path / "trials" / "0000"), "--yes", *place)
    assert trial.code == 2 and f"remove the study {study.id}" in trial.line
    assert "would remove" in runs("rm", "ours", *place).out and ours.path.exists()
    assert runs("rm", "ours", "--yes", *place).code == 0 and not ours.path.exists()
    assert runs("rm", "stage1", "--yes", *place).code == 0
    assert store.scan(tmp_path / "store") == [] and list((tmp_path / "store").rglob("*.pt")) == []


def test_verify_names_what_is_damaged(runs, stocked, tmp_path):
    import shutil

    shutil.copytree(stocked, tmp_path / "store")
    place = ("--runs", str(tmp_path / "store"))
    whole = runs("verify", *place)
    assert whole.code == 0 and "in 2 runs are whole" in whole.out
    one = runs("verify", "ours", *place)
    assert one.code == 0 and " in 1 run are whole" in one.out
    study, ours = (store.resolve(name, tmp_path / "store") for name in ("stage1", "ours"))
    policy, rows = ours.path / "policy.pt", study.path / "trials" / "0000" / "episodes.parquet"
    content = bytearray(policy.read_bytes())
    for place_in_file in range(len(content) // 2, len(content) // 2 + 128):  # more than what fills up between two parts
        content[place_in_file] ^= 255
    policy.write_bytes(content)
    rows.write_bytes(rows.read_bytes()[:-20])
    (study.path / "trials" / "0001" / "policy.pt").unlink()
    damaged = runs("verify", *place)
    assert damaged.code == 1 and "3 of " in damaged.line
    assert all(str(path) in damaged.out for path in (policy, rows, study.path / "trials" / "0001" / "policy.pt"))
