"""Where the YAML files are and what can be chosen among them; needs nothing but the file system."""

from pathlib import Path

from formctl.errors import ConfigError


def conf_dir() -> Path:
    """The folder of the YAML files: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "_conf", package.parent / "conf"):
        if (folder / "config.yaml").is_file():
            return folder
    raise ConfigError(f"no configuration found beside {package}: install formctl again")


def choices(group: str) -> list[str]:
    """Names that ``group=NAME`` accepts; empty when there is no such group."""
    return sorted(path.stem for path in (conf_dir() / group).glob("*.yaml"))
