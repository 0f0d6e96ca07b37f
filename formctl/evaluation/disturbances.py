"""One disturbance of a deployment at a time: the values of ``--vary`` and the settings they make."""

from collections.abc import Iterator, Sequence

from formctl.errors import ConfigError
from formctl.settings import Config, restore


def read_values(texts: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """``latency=0,0.02`` as numbers. Raises ConfigError for anything else."""
    found = {}
    for text in texts:
        key, _, values = text.removeprefix("deploy.").partition("=")
        try:
            found[key] = tuple(float(value) for value in values.split(","))
        except ValueError:
            raise ConfigError(
                f"--vary {text} cannot be used: write e.g. latency=0,0.02,0.04 or mass=0.9,1,1.1"
            ) from None
    return found


def disturbed(config: Config, varied: dict[str, tuple[float, ...]]) -> Iterator[Config]:
    """The settings with each value in turn, the deployment named after it; the settings themselves without any."""
    tree = config.tree["deploy"]
    if not varied:
        yield config
    for key, values in varied.items():
        if key not in tree or key in ("name", "seed"):
            keys = ", ".join(key for key in tree if key not in ("name", "seed", "thrust_clip"))
            raise ConfigError(f"--vary {key}: deploy has no such quantity; it has {keys}")
        for value in values:
            whole = type(tree[key])(value) if isinstance(tree[key], int) else value  # truth values are whole numbers
            changed = {key: [value, value] if isinstance(tree[key], list) else whole}
            yield restore(config.tree | {"deploy": tree | changed | {"name": f"{tree['name']} {key}={value:g}"}})
