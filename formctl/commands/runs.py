"""``formctl runs``: list, show and compare run folders."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from formctl.store import Run

app = typer.Typer(help="List, show and compare runs.", add_completion=False)

Root = Annotated[str, typer.Argument(metavar="[runs=FOLDER]", help="The store, if it is not ./runs.")]
Name = Annotated[
    str, typer.Argument(metavar="RUN", help="Path, id, beginning of an id, name (its newest) or KIND/NAME.")
]


@app.command()
def ls(
    store_at: Root = "runs=runs",
    kind: Annotated[str | None, typer.Option(help="search, train, eval, report, reproduce or bench.")] = None,
    name: Annotated[str | None, typer.Option(help="Only runs of this name.")] = None,
    status: Annotated[str | None, typer.Option(help="created, running, done, failed or interrupted.")] = None,
    profile: Annotated[str | None, typer.Option(help="Only runs of this profile.")] = None,
) -> None:
    """List runs, newest first."""
    from formctl import console, store

    known(kind, store.KINDS, "--kind")
    known(status, store.STATUSES, "--status")
    found = store.scan(root(store_at), kind=kind, name=name, status=status, profile=profile)
    if not found:
        console.say(f"no runs in {root(store_at)}/ that match; formctl train makes one")
        return
    columns = ("id", "kind", "name", "status", "profile", "minutes", "result")
    console.table(columns, [line(run) for run in found])


@app.command()
def show(run: Name, store_at: Root = "runs=runs") -> None:
    """Print a run's record and what lies in its folder."""
    from formctl import console, store

    found = store.resolve(run, root(store_at))
    console.print_yaml(found.view())
    files = sorted(path for path in found.path.rglob("*") if path.is_file() and path.name != "run.lock")
    console.table(("file", "bytes"), [(path.relative_to(found.path), path.stat().st_size) for path in files])


@app.command()
def diff(run: Name, other: Name, store_at: Root = "runs=runs") -> None:
    """Compare two runs: settings and results that differ."""
    from formctl import console, store
    from formctl.compare import differences

    left, right = (store.resolve(text, root(store_at)) for text in (run, other))
    lines = []
    for what, ours, theirs in (
        ("setting", left.config, right.config),
        ("result", left.record["result"], right.record["result"]),
        ("version", left.record["provenance"].get("versions", {}), right.record["provenance"].get("versions", {})),
        ("git", left.record["provenance"].get("git", {}), right.record["provenance"].get("git", {})),
    ):
        lines += [(what, key, *pair) for key, pair in differences(ours, theirs).items()]
    if not lines:
        console.say(f"{left.id} and {right.id} have the same settings, results and versions")
        return
    console.table(("what", "key", left.id, right.id), lines)


def root(text: str) -> Path:
    """The store that ``runs=FOLDER`` names. Raises ConfigError for anything else."""
    from formctl.errors import ConfigError

    key, _, folder = text.partition("=")
    if key != "runs" or not folder:
        raise ConfigError(f"cannot read {text!r}: write runs=FOLDER")
    return Path(folder)


def known(value: str | None, choices: tuple[str, ...], option: str) -> None:
    """Raise ConfigError for a filter that can never match."""
    from formctl.errors import ConfigError

    if value is not None and value not in choices:
        raise ConfigError(f"{option} {value} is none of {', '.join(choices)}")


def line(run: "Run") -> list[str]:
    """A run as a line of the list."""
    record = run.view()
    parts = [str(record[key]) for key in ("id", "kind", "name", "status", "profile")]
    return [*parts, f"{record['minutes']:.1f}", record["error"] or digest(record["result"])]


def digest(result: dict[str, Any]) -> str:
    """The figures people look for first."""
    figures = []
    for key, label in (("sr", "SR"), ("cfr", "CFR"), ("fm", "FM"), ("steps", "steps")):
        value = result.get(key)
        if value is not None:
            figures.append(f"{label} {value:,}" if isinstance(value, int) else f"{label} {value:.3f}")
    return ", ".join(figures)
