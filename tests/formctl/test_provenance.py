"""Provenance says where a result comes from and tells no secrets."""

import json

from formctl.store import provenance


def test_collect_names_code_versions_and_host_only():
    found = provenance.collect()
    assert set(found) == {"git", "versions", "host"}
    assert set(found["git"]) == {"commit", "dirty"}
    assert found["versions"]["torch"] and found["versions"]["python"]
    assert found["host"]["cores"] >= 1
    json.dumps(found)


def test_no_environment_variable_is_recorded(monkeypatch):
    monkeypatch.setenv("FORMCTL_TEST_SECRET", "correct-horse-battery")
    assert "correct-horse-battery" not in json.dumps(provenance.collect())


def test_secrets_are_taken_out_of_the_call():
    call = [
        "/home/ann/.venv/bin/formctl",
        "--storage=postgresql+psycopg://ann:hunter2@db.example/formctl",
        "logger.api_key=abc123",
        "password: s3cret",
        "seed=3",
    ]
    kept = provenance.argv(call)
    assert not any(secret in " ".join(kept) for secret in ("hunter2", "abc123", "s3cret"))
    assert kept[0] == "formctl" and kept[-1] == "seed=3" and "ann" in kept[1] and "db.example" in kept[1]


def test_outside_a_checkout_there_is_no_commit_and_no_diff(tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "__file__", str(tmp_path / "site-packages" / "formctl" / "store" / "provenance.py"))
    assert provenance.checkout() is None
    assert provenance.git() == {"commit": None, "dirty": None}
    provenance.save_diff(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_change_of_the_sources_is_kept_as_a_file(tmp_path, monkeypatch):
    import subprocess

    def git(*words):
        subprocess.run(["git", "-C", str(tmp_path), "-c", "user.name=n", "-c", "user.email=e", *words], check=True)

    package = tmp_path / "formctl" / "store"
    package.mkdir(parents=True)
    (tmp_path / "conf").mkdir()
    (tmp_path / "pyproject.toml").write_text("[project]\n")
    (package / "provenance.py").write_text("one = 1\n")
    (tmp_path / ".env").write_text("KEY=1\n")
    git("init", "-q")
    git("add", "-A")
    git("commit", "-qm", "first")
    monkeypatch.setattr(provenance, "__file__", str(package / "provenance.py"))
    assert provenance.git()["dirty"] is False and provenance.diff() == ""
    (package / "provenance.py").write_text("one = 2\n")
    (tmp_path / ".env").write_text("KEY=correct-horse-battery\n")
    assert provenance.git()["dirty"] is True and len(provenance.git()["commit"]) == 40
    folder = tmp_path / "run"
    folder.mkdir()
    provenance.save_diff(folder)
    text = (folder / "git.diff").read_text()
    assert "+one = 2" in text and "correct-horse-battery" not in text
