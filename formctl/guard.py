"""Our top-level packages have common names: find another distribution's package in the place of ours, and name it."""

import sys
from importlib.machinery import PathFinder
from pathlib import Path

PACKAGES = ("envs", "algos", "baselines", "analysis")
"""Packages that ship with formctl, under names that other distributions use as well."""


class NameClash(ValueError):
    """A package of another distribution stands where one of ours should."""


class NotPosix(ValueError):
    """A system without process groups, resource limits and folders that can be synchronised."""


def check() -> None:
    """Raise NotPosix on Windows, and NameClash when importing one of our packages would give somebody else's.

    Costs four look-ups, no import.
    """
    if sys.platform == "win32":
        raise NotPosix("formctl needs a POSIX system: on Windows run it in WSL 2, see docs/install.md")
    home = Path(__file__).resolve().parent.parent
    for package in PACKAGES:
        spec = PathFinder.find_spec(package)
        found = Path(spec.origin).resolve().parent if spec and spec.origin else None
        if found is not None and found.parent != home:
            raise NameClash(_complaint(package, found))


def intruders() -> dict[str, list[str]]:
    """Other distributions that install into our packages, by package: what ``check`` cannot see at start-up.

    Reads the file list of every installed distribution: slow, for ``formctl doctor``.
    """
    from importlib.metadata import packages_distributions

    owners = packages_distributions()
    others = {package: sorted(set(owners.get(package, [])) - {"formctl"}) for package in PACKAGES}
    return {package: names for package, names in others.items() if names}


def _complaint(package: str, found: Path) -> str:
    culprits = intruders().get(package)
    if not culprits:
        return f"{found} hides formctl's own package {package!r}: rename that folder or take it off the Python path"
    names = ", ".join(culprits)
    return (
        f"distribution {names} brings a package {package!r} that hides formctl's own ({found}): pip uninstall {names}"
    )
