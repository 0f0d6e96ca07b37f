"""Formations of the user's own: points in the plane, and points in a CSV file."""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from formctl.errors import ConfigError


def resolve(tree: dict[str, Any]) -> None:
    """Put every ``formation`` of the composed tree as points (x, y, z) in m. Raises ConfigError."""
    for place, scenario in _scenarios(tree):
        formation = scenario.get("formation")
        if isinstance(formation, str) and formation.endswith(".csv"):
            scenario["formation"] = read(Path(formation).expanduser(), f"{place}.formation")
        elif isinstance(formation, list) and formation and all(_in_plane(point) for point in formation):
            scenario["formation"] = [[*point, 0.0] for point in formation]


def read(path: Path, key: str) -> list[list[float]]:
    """The points of a CSV file: one drone a line, x,y or x,y,z in m; a first line of names is passed over."""
    try:
        lines = [line for line in csv.reader(path.read_text(encoding="utf-8").splitlines()) if line]
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror.lower() if isinstance(error, OSError) and error.strerror else "is not UTF-8 text"
        raise ConfigError(f"{key}={path} cannot be read: {reason}") from error
    points: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        try:
            point = [float(part) for part in line]
        except ValueError as error:
            if number == 1:
                continue
            raise ConfigError(f"{key}={path}, line {number}: write x,y or x,y,z in m") from error
        if len(point) not in (2, 3):
            raise ConfigError(f"{key}={path}, line {number}: write x,y or x,y,z in m")
        points.append([*point, 0.0][:3])
    if not points:
        raise ConfigError(f"{key}={path} has no point: write one drone a line, x,y or x,y,z in m")
    return points


def _scenarios(tree: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every place of the composed tree that describes a scenario, or changes one."""
    places = [("scenario", tree.get("scenario")), ("search.scenario", (tree.get("search") or {}).get("scenario"))]
    curriculum = tree.get("curriculum")
    for number, period in enumerate(curriculum.get("periods") or () if isinstance(curriculum, dict) else ()):
        places.append((f"curriculum.periods.{number}.scenario", period.get("scenario")))
    yield from ((place, scenario) for place, scenario in places if isinstance(scenario, dict))


def _in_plane(point: Any) -> bool:
    return isinstance(point, list) and len(point) == 2
