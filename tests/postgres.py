"""A PostgreSQL server of our own for the time of a test: password-protected, on a free port, gone afterwards."""

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PASSWORD = "correct-horse-battery"
PROGRAMS = ("initdb", "pg_ctl")


def missing() -> str:
    """Why no server can be started here; empty when it can."""
    absent = [name for name in PROGRAMS if shutil.which(name) is None]
    if absent:
        return f"no PostgreSQL server on this machine ({', '.join(absent)} not found)"
    if os.geteuid() == 0 and (shutil.which("runuser") is None or not _has_user("postgres")):
        return "PostgreSQL does not run as root, and there is no user postgres to run it as"
    return ""


@contextmanager
def server() -> Iterator[str]:
    """Start a server and yield its address, password included. As root it runs as the user postgres."""
    with tempfile.TemporaryDirectory(prefix="formctl-postgres-") as name:
        folder = Path(name)
        (folder / "password").write_text(PASSWORD)
        if os.geteuid() == 0:
            owner = pwd.getpwnam("postgres")
            for path in (folder, folder / "password"):
                os.chown(path, owner.pw_uid, owner.pw_gid)
        data, port = folder / "data", _free_port()
        _run("initdb", "-D", data, "-U", "formctl", "--auth=scram-sha-256", "-E", "UTF8", f"--pwfile={folder}/password")
        options = f"-p {port} -k {folder} -c listen_addresses=127.0.0.1 -c fsync=off"
        _run("pg_ctl", "-D", data, "-l", folder / "log", "-o", options, "-w", "start")
        try:
            yield f"postgresql://formctl:{PASSWORD}@127.0.0.1:{port}/postgres"
        finally:
            _run("pg_ctl", "-D", data, "-m", "immediate", "stop")


def _run(*words: object) -> None:
    call = [str(word) for word in words]
    if os.geteuid() == 0:
        call = ["runuser", "-u", "postgres", "--", *call]
    subprocess.run(call, check=True, capture_output=True, cwd="/")


def _has_user(name: str) -> bool:
    return name in (entry.pw_name for entry in pwd.getpwall())


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
