"""The rooms of ``analysis`` in one direction, no circle of files, no name twice, imports at the top."""

import ast
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("data", "stats", "tables", "figures", "claims", "report")
"""Each may know those before it; ``recordings`` stand beside them."""
SOURCES = sorted((ROOT / "analysis").rglob("*.py"))
TREES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES}


def module(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module(path) for path in SOURCES}


def imported(tree: ast.AST) -> Iterator[str]:
    """Modules that a file imports, in dots."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in MODULES else str(node.module) for name in names)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_room_knows_those_before_it(path: Path) -> None:
    room = path.relative_to(ROOT / "analysis").parts[0]
    names = set(imported(TREES[path]))
    rooms = {name.split(".")[1] for name in names if name.startswith("analysis.")}
    if room == "recordings":
        assert {name for name in names if name.startswith("analysis.")} <= {
            *(name for name in MODULES if name.startswith("analysis.recordings")),
            "analysis.data.text",
        }
    elif room in ROOMS:
        assert rooms <= {"recordings", *ROOMS[: ROOMS.index(room) + 1]}
    assert {name for name in names if name.startswith("envs")} <= {"envs.vocabulary"}


def test_no_circle_of_files() -> None:
    knows = {module(path): set(imported(tree)) & MODULES - {module(path)} for path, tree in TREES.items()}
    while leaves := {name for name, others in knows.items() if not others & knows.keys()}:
        knows = {name: others for name, others in knows.items() if name not in leaves}
    assert not knows


def test_public_class_names_are_used_once() -> None:
    names = Counter(node.name for tree in TREES.values() for node in tree.body if isinstance(node, ast.ClassDef))
    assert not [name for name, count in names.items() if count > 1 and not name.startswith("_")]


def test_imports_stand_at_the_top() -> None:
    inside = [
        f"{path.relative_to(ROOT)}:{inner.lineno}"
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        for inner in ast.walk(node)
        if isinstance(inner, ast.Import | ast.ImportFrom)
    ]
    assert not inside


def test_nothing_of_it_needs_a_simulator() -> None:
    script = (
        "import sys, analysis.report, analysis.recordings.page; print({'torch', 'mujoco', 'optuna'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.strip() == "set()", done.stderr
