"""Run folders: atomic, locked, found again, and honest about processes that died."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from formctl import store
from formctl.store import files, lock
from formctl.store.files import StoreError


def make(root: Path, kind: str = "train", name: str = "default", **fields) -> store.Run:
    call = {"config": {"a": 1}, "provenance": {}, "argv": ["formctl"], "profile": "smoke", "seed": 0}
    return store.create(root, kind, name, **(call | fields))


def test_create_writes_record_and_config(tmp_path):
    run = make(tmp_path, name="first", method={"name": "mappo"})
    assert run.path.parent == tmp_path / "train" / "first"
    assert run.path.name == run.id
    assert run.status == "created"
    assert run.record["method"] == {"name": "mappo"}
    assert run.config == {"a": 1}


@pytest.mark.parametrize("name", ["", "a/b", "../up", ".hidden", "two words"])
def test_names_that_are_no_folder_are_refused(tmp_path, name):
    with pytest.raises(StoreError, match="cannot name a folder"):
        make(tmp_path, name=name)
    assert list(tmp_path.iterdir()) == []


def test_work_records_how_it_ended(tmp_path):
    run = make(tmp_path)
    with run.work() as live:
        assert run.status == "running"
        live.update(result={"cfr": 0.5})
    assert run.status == "done" and run.record["result"] == {"cfr": 0.5} and run.record["minutes"] >= 0

    with pytest.raises(KeyboardInterrupt), run.work():
        raise KeyboardInterrupt
    assert run.status == "interrupted" and run.record["error"] is None

    with pytest.raises(RuntimeError), run.work():
        raise RuntimeError("loss is nan\nsecond line")
    assert run.status == "failed" and run.record["error"] == "RuntimeError: loss is nan"


def test_minutes_add_up_over_sittings(tmp_path):
    run = make(tmp_path)
    run.update(minutes=7.0)
    with run.work() as live:
        assert live.minutes >= 7.0
    assert run.record["minutes"] >= 7.0


def test_a_run_has_one_owner(tmp_path):
    run = make(tmp_path)
    with run.work(), pytest.raises(StoreError, match=f"in use by process {os.getpid()}"), run.work():
        pass
    assert run.status == "done"


WORKER = """
import sys, time
from pathlib import Path
from formctl import store
run = store.Run(Path(sys.argv[1]))
with run.work() as live:
    for step in range(10**9):
        live.log({"steps": step, "text": "x" * 2000})
        if step == 3:
            print("working", flush=True)
"""


def test_killed_process_shows_as_interrupted_and_leaves_readable_files(tmp_path):
    run = make(tmp_path)
    worker = subprocess.Popen([sys.executable, "-c", WORKER, str(run.path)], stdout=subprocess.PIPE, text=True)
    assert worker.stdout is not None and worker.stdout.readline() == "working\n"
    assert run.status == "running"
    worker.send_signal(signal.SIGKILL)
    worker.wait()
    assert run.record["status"] == "running"  # nobody was left to write
    assert run.status == "interrupted"
    steps = [row["steps"] for row in run.metrics()]
    assert steps == list(range(len(steps))) and len(steps) >= 4
    with run.work():  # and the run can be taken up again
        assert run.status == "running"


def test_the_lock_tells_whether_a_run_of_another_host_name_is_at_work(tmp_path, monkeypatch):
    """As containers of one machine have names of their own: its word counts only where a lock may not show."""
    run = make(tmp_path)
    process = {"pid": 1, "host": "elsewhere", "machine": "another"}
    run.update(status="running", process=process)
    (run.path / "run.lock").touch()
    assert run.status == "interrupted"
    with lock.hold(run.path / "run.lock"):
        assert run.status == "running"
    monkeypatch.setattr(lock, "shows", lambda path: False)
    assert run.status == "running"
    run.update(process=process | {"machine": lock.machine()})  # this very machine under another name
    assert run.status == "interrupted"
    run.update(process=process)
    (run.path / "run.lock").unlink()  # the way out for who knows better
    assert run.status == "interrupted"


def test_locks_show_on_the_machines_own_file_systems(tmp_path, monkeypatch):
    assert lock.shows(tmp_path)
    mounts = [("/", "ext4"), (str(tmp_path), "nfs4"), (f"{tmp_path}/scratch", "xfs")]
    monkeypatch.setattr(lock, "_mounts", lambda: iter(mounts))
    assert not lock.shows(tmp_path / "runs") and lock.shows(tmp_path / "scratch" / "runs")


def test_torn_last_line_is_left_out_and_rewound(tmp_path):
    run = make(tmp_path)
    path = run.path / "metrics.jsonl"
    with run.work() as live:
        for steps in (10, 20, 30):
            live.log({"steps": steps})
        with path.open("ab") as file:
            file.write(b'{"steps": 40, "lo')
        assert [row["steps"] for row in run.metrics()] == [10, 20, 30]
        live.rewind(20)
        live.log({"steps": 30, "again": True})
    assert path.read_text().splitlines() == ['{"steps": 10}', '{"steps": 20}', '{"steps": 30, "again": true}']


def test_damage_before_the_last_line_is_an_error(tmp_path):
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"steps": 1}\n{"st\n{"steps": 3}\n')
    with pytest.raises(StoreError, match="damaged at line 2"):
        files.read_lines(path)


def test_atomic_keeps_the_old_file_when_writing_fails(tmp_path):
    path = tmp_path / "record.json"
    files.write_json(path, {"good": 1})
    with pytest.raises(RuntimeError), files.atomic(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError("crash")
    assert files.read_json(path) == {"good": 1}
    assert [item.name for item in tmp_path.iterdir()] == ["record.json"]


WRITER = """
import sys
from pathlib import Path
from formctl.store import files, lock
print("writing", flush=True)
for number in range(10**9):
    files.write_json(Path(sys.argv[1]), {"number": number, "text": str(number) * 5000})
"""


def test_a_reader_never_sees_half_a_file(tmp_path):
    path = tmp_path / "record.json"
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True)
    try:
        assert writer.stdout is not None and writer.stdout.readline() == "writing\n"
        while not path.exists():
            time.sleep(0.01)
        seen = set()
        while len(seen) < 20:
            content = files.read_json(path)
            assert content["text"] == str(content["number"]) * 5000
            seen.add(content["number"])
    finally:
        writer.kill()
        writer.wait()
    assert files.read_json(path)["text"]


def test_json_has_no_nan_and_no_array_types(tmp_path):
    import numpy as np

    path = tmp_path / "record.json"
    files.write_json(path, {"nan": float("nan"), "rate": np.float32(0.5), "flags": np.array([True]), "path": tmp_path})
    assert json.loads(path.read_text()) == {"nan": None, "rate": 0.5, "flags": [True], "path": str(tmp_path)}


def test_full_disk_is_one_line(tmp_path):
    with (
        pytest.raises(StoreError, match=r"cannot write .*no space left on device") as caught,
        files.disk_errors(tmp_path),
    ):
        Path("/dev/full").write_text("x")
    assert "\n" not in str(caught.value)


def test_a_file_where_the_store_should_be_is_one_line(tmp_path):
    (tmp_path / "runs").write_text("I am a file")
    with pytest.raises(StoreError, match="cannot write"):
        make(tmp_path / "runs")


def test_scan_filters_and_sorts_newest_first(tmp_path):
    first = make(tmp_path, name="a")
    time.sleep(0.002)
    second = make(tmp_path, kind="eval", name="a")
    time.sleep(0.002)
    third = make(tmp_path, name="b", profile="paper")
    (tmp_path / "train" / "a" / "junk").mkdir()
    assert [run.path for run in store.scan(tmp_path)] == [third.path, second.path, first.path]
    assert [run.path for run in store.scan(tmp_path, kind="train")] == [third.path, first.path]
    assert [run.path for run in store.scan(tmp_path, name="a")] == [second.path, first.path]
    assert [run.path for run in store.scan(tmp_path, profile="paper")] == [third.path]
    assert store.scan(tmp_path, status="failed") == []
    assert store.scan(tmp_path / "nowhere") == []


def test_resolve_by_path_id_prefix_and_name(tmp_path):
    old = make(tmp_path, name="ours")
    time.sleep(0.002)
    new = make(tmp_path, name="ours")
    for text in (str(new.path), new.id, new.id[:-1], "ours", "train/ours", f"train/ours/{new.id}"):
        if text == new.id[:-1] and old.id.startswith(text):
            continue  # two of sixteen ids in the same second share three hexadecimal digits
        assert store.resolve(text, tmp_path).path == new.path
    assert store.resolve(old.id, tmp_path).path == old.path


def test_resolve_prefers_runs_that_hold_the_file(tmp_path):
    old = make(tmp_path, name="ours")
    (old.path / "policy.pt").write_bytes(b"weights")
    make(tmp_path, name="ours")
    assert store.resolve("ours", tmp_path, holding="policy.pt").path == old.path


def test_resolve_says_what_is_wrong(tmp_path):
    with pytest.raises(StoreError, match="there is none yet"):
        store.resolve("ours", tmp_path)
    make(tmp_path, name="ours")
    make(tmp_path, name="theirs")
    with pytest.raises(StoreError, match=r"no run 'mine' in .*: there are train/ours, train/theirs"):
        store.resolve("mine", tmp_path)
    with pytest.raises(StoreError, match="is ambiguous: 2 runs begin so"):
        store.resolve("20", tmp_path)
    (tmp_path / "plain").mkdir()
    with pytest.raises(StoreError, match=r"is not a run folder \(no run.json\)"):
        store.resolve(str(tmp_path / "plain"), tmp_path)


def test_foreign_schema_and_damaged_record(tmp_path):
    run = make(tmp_path)
    run.update(schema=99)
    with pytest.raises(StoreError, match="schema 99"):
        store.Run.open(run.path)
    (run.path / "run.json").write_text('{"schema": 1, "ki')
    with pytest.raises(StoreError, match="cannot be read"):
        store.Run.open(run.path)
    assert store.scan(tmp_path) == []
