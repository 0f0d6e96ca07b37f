"""Faults of YAML files, said in one line with file and line."""

from pathlib import Path

import yaml
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from formctl.errors import ConfigError
from formctl.settings.paths import conf_dir


def explain(error: Exception) -> ConfigError:
    """The complaint about the file of ``conf/`` that cannot be read; ``error`` is what some library said of it."""
    for path in sorted(conf_dir().rglob("*.yaml")):
        if complaint := fault(path):
            return ConfigError(complaint)
    return ConfigError(f"a file of {conf_dir()} cannot be read: {' '.join(str(error).split())}")


def fault(path: Path) -> str:
    """What is wrong with a YAML file, in one line; empty where it can be read."""
    try:
        OmegaConf.load(path)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = "" if mark is None else f", line {mark.line + 1}"
        return f"{path}{where}: {error.problem or error.context}"
    except UnicodeDecodeError as error:
        line = path.read_bytes()[: error.start].count(b"\n") + 1
        return f"{path}, line {line}: is not UTF-8 text"
    except (yaml.YAMLError, OmegaConfBaseException, OSError) as error:
        return f"{path}: {' '.join(str(error).split())}"
    return ""
