"""What is not installed with formctl itself, and the line that installs it."""

from importlib.util import find_spec

from formctl.errors import ConfigError


def require(module: str, extra: str, package: str = "") -> None:
    """Raise ConfigError, one line, where ``module`` (of ``package``) is not installed."""
    if find_spec(module) is None:
        raise ConfigError(f"{package or module} is not installed: pip install 'formctl[{extra}]'")
