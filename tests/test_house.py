"""Rules of the house: who may import whom, no dead key, no key without a comment, no file that grew too long."""

import ast
import re
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
    "analysis": {"analysis", "envs"},  # of envs its vocabulary only: tests/analysis/test_layout.py
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


def top_imports(tree: ast.Module) -> Iterator[ast.Import | ast.ImportFrom]:
    """Imports that run when the module is imported: none in functions, none for type checkers only."""
    for node in tree.body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node


def graph(package: str) -> dict[str, set[str]]:
    """Modules of a package and those of the same package that importing them imports."""
    paths = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in (ROOT / package).rglob("*.py")}
    modules = {module.removesuffix(".__init__"): path for module, path in paths.items()}
    edges: dict[str, set[str]] = {}
    for module, path in modules.items():
        targets = set()
        for node in top_imports(ast.parse(path.read_text())):
            for alias in node.names:
                source = f"{node.module}.{alias.name}" if isinstance(node, ast.ImportFrom) else alias.name
                targets |= {name for name in (source, source.rpartition(".")[0]) if name in modules}
        edges[module] = targets - {module, package}
    return edges


@pytest.mark.parametrize("package", PACKAGES)
def test_no_files_import_each_other_in_a_circle(package: str) -> None:
    edges = {module: {target for target in targets if target != module} for module, targets in graph(package).items()}
    for module in [name for name in edges if any(other.startswith(f"{name}.") for other in edges)]:
        edges[module] = set()  # a folder's own file gathers what lies in it
    while free := [module for module, targets in edges.items() if not targets & set(edges)]:
        for module in free:
            del edges[module]
    assert not edges


ROOMS_WITH_IMPORTS_AT_THE_TOP = ("envs", "algos", "baselines", "formctl/evaluation", "formctl/search",
                                 "formctl/deployment", "formctl/viewers", "formctl/stages")  # fmt: skip


@pytest.mark.parametrize("folder", ROOMS_WITH_IMPORTS_AT_THE_TOP)
def test_imports_stand_at_the_top(folder: str) -> None:
    """At most three in 1,000 lines stand in functions: what takes seconds and few need."""
    sources = [path.read_text() for path in sorted((ROOT / folder).rglob("*.py"))]
    functions = [
        node
        for source in sources
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    inside = {
        (part.lineno, ast.dump(part))
        for function in functions
        for part in ast.walk(function)
        if isinstance(part, ast.Import | ast.ImportFrom)
    }
    lines = sum(source.count("\n") for source in sources)
    assert len(inside) <= max(3, 3 * lines / 1000), f"{len(inside)} imports in functions of {lines} lines"


def test_commands_import_no_commands() -> None:
    others = [
        f"{name(path)}: {module}"
        for path in (ROOT / "formctl" / "commands").glob("*.py")
        for module in re.findall(r"from formctl\.commands(?:\.(\w+))? import", path.read_text())
        if module != "options"
    ]
    assert not others
