"""Rules of the house: who may import whom, no dead key, no key without a comment, no file that grew too long."""

import ast
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import pytest

from formctl.settings import Config, choices, conf_dir, manual
from formctl.settings.config import SPECS

ROOT = Path(__file__).parents[1]
PACKAGES = ("formctl", "envs", "algos", "baselines", "analysis")
MAY_IMPORT = {
    "formctl": {"formctl", "envs", "algos", "baselines", "analysis"},
    "algos": {"algos", "envs"},
    "baselines": {"baselines", "envs"},
    "analysis": {"analysis"},
    "envs": {"envs"},
}
ROOMS = ("store", "engines", "viewers", "evaluation", "deployment", "search", "stages", "commands")
"""Of formctl: each may know those before it."""
ONLY_IN_FORMCTL = {"hydra", "omegaconf", "optuna", "typer", "rich"}
NOWHERE = {"click"}  # typer brings its own
NOT_IN_ANALYSIS = {"torch", "torchrl", "tensordict", "mujoco"}
SOURCES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
YAML_FILES = sorted(conf_dir().rglob("*.yaml"))


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def imported(tree: ast.AST) -> Iterator[str]:
    """Top-level packages that a module imports, anywhere in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports name their package"
            yield (node.module or "").split(".")[0]


@pytest.mark.parametrize("path", SOURCES, ids=name)
def test_arrows_point_down(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    found = set(imported(ast.parse(path.read_text())))
    assert found & set(PACKAGES) <= MAY_IMPORT[package]
    assert not found & NOWHERE
    if package != "formctl":
        assert not found & ONLY_IN_FORMCTL
    if package == "analysis":
        assert not found & NOT_IN_ANALYSIS


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_know_those_before_them(room: str) -> None:
    sources = sorted((ROOT / "formctl" / room).rglob("*.py"))
    assert sources
    above = set(ROOMS[ROOMS.index(room) + 1 :])
    assert not [name(path) for path in sources if above & set(own_imports(ast.parse(path.read_text())))]


def own_imports(tree: ast.AST) -> Iterator[str]:
    """What a module imports of ``formctl``, anywhere in it: the first name below the package."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[1] for alias in node.names if alias.name.startswith("formctl."))
        elif isinstance(node, ast.ImportFrom) and node.module == "formctl":
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("formctl."):
            yield (node.module or "").split(".")[1]


@pytest.mark.parametrize("path", [*SOURCES, *sorted((ROOT / "tests").rglob("*.py"))], ids=name)
def test_files_stay_short(path: Path) -> None:
    assert len(path.read_text().splitlines()) < 400, "past 400 lines something wants a room of its own"


def settings_classes() -> set[Any]:
    """Every dataclass that a group of ``conf/`` is read into, and the dataclasses and named tuples inside those."""
    found: set[Any] = set()

    def visit(kind: Any) -> None:
        if (is_dataclass(kind) or hasattr(kind, "_fields")) and kind not in found:
            found.add(kind)
            for hint in get_type_hints(kind, include_extras=False).values():
                visit(hint)
        elif get_origin(kind) is not None:
            for part in get_args(kind):
                visit(part)

    for group, dotted in SPECS.items():
        targets = {dotted} if dotted else {target(group, choice) for choice in choices(group)}
        for spec in targets:
            visit(load(spec))
    for choice in choices("baseline"):
        visit(get_type_hints(load(target("baseline", choice)).__init__)["spec"])
    return found


def target(group: str, choice: str) -> str:
    """The ``target`` of a group's file, its own or inherited."""
    found = ""
    for path in manual.lineage(group, choice):
        for line in path.read_text().splitlines():
            if line.startswith("target:"):
                found = line.split()[1]
    return found


def load(dotted: str) -> Any:
    module, _, attribute = dotted.rpartition(".")
    return getattr(import_module(module), attribute)


def test_every_key_is_read() -> None:
    read = {
        node.attr
        for path in SOURCES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load)
    }
    classes = settings_classes()
    assert len(classes) >= 15
    dead = {f"{kind.__name__}.{key}" for kind in classes for key in get_type_hints(kind) if key not in read}
    dead -= {f"{kind.__name__}.{key}" for kind in classes for key in ("target", "deviations")}  # read as settings
    assert not dead
    assert not {field.name for field in fields(Config)} - read


@pytest.mark.parametrize("path", YAML_FILES, ids=lambda path: str(path.relative_to(conf_dir())))
def test_every_key_has_a_comment(path: Path) -> None:
    """On its line or above it; a key that another file of the group introduced may have it there."""
    place = path.relative_to(conf_dir())
    first = next(line for line in path.read_text().splitlines() if not line.startswith("# @"))
    assert first.startswith("# ") and first.endswith("."), "a file begins with one sentence that says what it is"
    own = manual.comments(path)
    known = own if len(place.parts) == 1 else manual.explain(str(place.parent), place.stem)
    leaves = [key for key in own if not any(other.startswith(f"{key}.") for other in own)]
    assert not [key for key in leaves if not (own[key] or known[key] or key.endswith("name"))]
