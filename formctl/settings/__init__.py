"""Settings: ``conf/`` composed with what the user types, checked, explained, and made into the objects that run."""

from formctl.errors import ConfigError
from formctl.settings.config import Config, chosen, compose, restore
from formctl.settings.overrides import expand_sweep
from formctl.settings.paths import choices, conf_dir

__all__ = [
    "Config",
    "ConfigError",
    "choices",
    "chosen",
    "compose",
    "conf_dir",
    "expand_sweep",
    "restore",
]
