"""``formctl runs``: list, show, compare, name, check and remove run folders."""

from pathlib import Path
from typing import Annotated

import typer

from formctl.commands.options import StoreOption, StoreWords, store_of, take_store

app = typer.Typer(help="List, show and compare runs, tag, verify and remove them.", add_completion=False)

Name = Annotated[
    str, typer.Argument(metavar="RUN", help="Path, id, beginning of an id, name (its newest) or KIND/NAME.")
]


@app.command()
def ls(
    store_at: StoreWords = None,
    at: StoreOption = None,
    kind: Annotated[str | None, typer.Option(help="search, train, eval, report, reproduce or bench.")] = None,
    name: Annotated[str | None, typer.Option(help="Only runs of this name.")] = None,
    status: Annotated[str | None, typer.Option(help="created, running, done, failed or interrupted.")] = None,
    profile: Annotated[str | None, typer.Option(help="Only runs of this profile.")] = None,
    tag: Annotated[str | None, typer.Option(help="Only runs with this tag.")] = None,
) -> None:
    """List runs, newest first."""
    root = store_of(store_at, at)
    from formctl.stages import runs

    runs.list_runs(root, kind=kind, name=name, status=status, profile=profile, tag=tag)


@app.command()
def show(run: Name, store_at: StoreWords = None, at: StoreOption = None) -> None:
    """Print a run's record and what lies in its folder."""
    root = store_of(store_at, at)
    from formctl.stages import runs

    runs.show(run, root)


@app.command()
def diff(run: Name, other: Name, store_at: StoreWords = None, at: StoreOption = None) -> None:
    """Compare two runs: settings and results that differ."""
    root = store_of(store_at, at)
    from formctl.stages import runs

    runs.diff(run, other, root)


@app.command("tag")
def tag_command(
    run: Name,
    tags: Annotated[list[str], typer.Argument(metavar="TAG...", help="Words, e.g. paper seeds-ok.")],
    store_at: StoreOption = None,
    remove: Annotated[bool, typer.Option("--remove", help="Take the tags away.")] = False,
) -> None:
    """Put tags on a run; runs ls --tag finds them."""
    words, root = take_store(tags, store_at)
    from formctl.stages import runs

    runs.tag(run, words, root, remove=remove)


@app.command()
def rm(
    names: Annotated[list[str], typer.Argument(metavar="RUN...", help="Paths, ids or names (a name: its newest).")],
    store_at: StoreOption = None,
    yes: Annotated[bool, typer.Option("--yes", help="Really remove; without it only what would go is said.")] = False,
) -> None:
    """Remove runs; refuses what a study or a report still needs."""
    words, root = take_store(names, store_at)
    from formctl.stages import runs

    runs.remove(words, root, really=yes)


@app.command()
def verify(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="RUN|STORE...", help="Runs, or a published store. Default: every run in the store."),
    ] = None,
    store_at: StoreOption = None,
    seconds: Annotated[float, typer.Option(help="Begin no flight of a published store later than that.")] = 60.0,
) -> None:
    """Check that checkpoints, rows, banks and studies are whole.

    A published store (formctl runs verify reference) is held against its manifest too, and rows of it are flown again.
    """
    words, root = take_store(names or [], store_at)
    from formctl.stages import verify as checks

    checks.verify_runs(words, root, seconds)


@app.command()
def seal(folder: Annotated[Path, typer.Argument(help="A store that is to be published, e.g. runs/reference.")]) -> None:
    """Write the manifest of a store that travels with the source: a hash of every file."""
    from formctl.stages import runs

    runs.seal(folder)
