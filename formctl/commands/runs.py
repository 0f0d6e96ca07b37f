"""``formctl runs``: list, show, compare, name, check and remove run folders."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from formctl.store import Run

app = typer.Typer(help="List, show and compare runs, tag, verify and remove them.", add_completion=False)

Root = Annotated[str, typer.Argument(metavar="[runs=FOLDER]", help="The store, if it is not ./runs.")]
Store = Annotated[str, typer.Option("--runs", metavar="FOLDER", help="The store.")]
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
    tag: Annotated[str | None, typer.Option(help="Only runs with this tag.")] = None,
) -> None:
    """List runs, newest first."""
    from formctl import console, store

    known(kind, store.KINDS, "--kind")
    known(status, store.STATUSES, "--status")
    found = store.scan(root(store_at), kind=kind, name=name, status=status, profile=profile)
    if tag is not None:
        found = [run for run in found if tag in run.record.get("tags", [])]
    if not found:
        filtered = any(value is not None for value in (kind, name, status, profile, tag))
        console.say(f"no runs in {root(store_at)}/ that match" if filtered else nothing(root(store_at)))
        return
    columns = ("id", "kind", "name", "status", "profile", "minutes", "tags", "result")
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
    from formctl.settings.compare import differences

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


@app.command("tag")
def tag_command(
    run: Name,
    tags: Annotated[list[str], typer.Argument(metavar="TAG...", help="Words, e.g. paper seeds-ok.")],
    store_at: Store = "runs",
    remove: Annotated[bool, typer.Option("--remove", help="Take the tags away.")] = False,
) -> None:
    """Put tags on a run; runs ls --tag finds them."""
    from formctl import console, store

    for tag in tags:
        store.check_name(tag)
    found = store.resolve(run, Path(store_at))
    known: list[str] = found.record.get("tags", [])
    after = [tag for tag in known if tag not in tags] if remove else list(dict.fromkeys([*known, *tags]))
    found.update(tags=after)
    console.say(f"{found.path}: {', '.join(after) or 'no tags'}")


@app.command()
def rm(
    runs: Annotated[list[str], typer.Argument(metavar="RUN...", help="Paths, ids or names (a name: its newest).")],
    store_at: Store = "runs",
    yes: Annotated[bool, typer.Option("--yes", help="Really remove; without it only what would go is said.")] = False,
) -> None:
    """Remove runs; refuses what a study or a report still needs."""
    from formctl import console, store
    from formctl.store import removal

    found = [store.resolve(text, Path(store_at)) for text in runs]
    for run in found:
        removal.refuse_needed(run, Path(store_at))
    for run in found:
        if yes:
            console.say(f"removed {run.path}: {removal.remove(run, Path(store_at)) / 1e6:.1f} MB")
        else:
            console.say(f"would remove {run.path}; add --yes")


@app.command()
def verify(
    runs: Annotated[
        list[str] | None,
        typer.Argument(metavar="RUN|STORE...", help="Runs, or a published store. Default: every run in the store."),
    ] = None,
    store_at: Store = "runs",
    seconds: Annotated[float, typer.Option(help="Begin no flight of a published store later than that.")] = 60.0,
) -> None:
    """Check that checkpoints, rows, banks and studies are whole.

    A published store (formctl runs verify reference) is held against its manifest too, and rows of it are flown again.
    """
    from analysis.words import counted
    from formctl import console, store
    from formctl.errors import RunFailed
    from formctl.stages.verify import files, problems
    from formctl.store import manifest

    place = Path(store_at)
    stores = {text: root for text in runs or () if (root := published(text, place)) is not None}
    found = [store.resolve(text, place) for text in runs or () if text not in stores]
    found += [run for root in (stores.values() if runs else [place]) for run in store.scan(root)]
    if not found:
        console.say(nothing(place))
        return
    count = 0
    damaged: list[tuple[Path, str]] = []
    for run in found:
        count += len(files(run))
        damaged += problems(run)
    for folder in stores.values():
        damaged += manifest.differences(folder)
    for path, what in damaged:
        console.say(f"{path}: {what}")
    checked = f"{counted(count, 'file')} in {counted(len(found), 'run')}"
    if damaged:
        raise RunFailed(f"{len(damaged)} of {checked} {'is' if len(damaged) == 1 else 'are'} damaged or missing")
    console.say(f"{checked} {'is' if count == 1 else 'are'} whole")
    for folder in stores.values():
        console.say(f"{folder}: as published ({manifest.text(folder)})")
        fly_again(folder, seconds)


@app.command()
def seal(folder: Annotated[Path, typer.Argument(help="A store that is to be published, e.g. runs/reference.")]) -> None:
    """Write the manifest of a store that travels with the source: a hash of every file."""
    from formctl import console, store
    from formctl.store import manifest

    if not store.scan(folder):
        raise store.StoreError(f"{folder} is no store: it has no run")
    manifest.write(folder)
    for path in manifest.personal(folder):
        console.warn(f"{path} names a path of this machine")
    console.say(f"{folder / manifest.NAME}: {manifest.text(folder)}")


def published(text: str, place: Path) -> Path | None:
    """The published store that ``text`` names, by its path or inside the store; None where it names none."""
    from formctl.store import manifest

    return next((root for root in (place / text, Path(text)) if (root / manifest.NAME).is_file()), None)


def fly_again(folder: Path, seconds: float) -> None:
    """Fly a sample of a published store's rows. Raises RunFailed where one is not what it was."""
    from formctl import console
    from formctl.errors import RunFailed
    from formctl.evaluation import reverify

    outcomes = list(reverify.sample(folder, seconds))
    lines = [(o.method, o.run.id, o.rows, o.equal, f"{o.difference:.2g}", o.verdict) for o in outcomes]
    columns = ("method", "evaluation", "rows flown again", "the same bits", "largest difference", "verdict")
    console.table(columns, lines)
    reverify.refuse(outcomes)
    if wrong := [outcome for outcome in outcomes if outcome.wrong]:
        raise RunFailed(f"{len(wrong)} of {len(outcomes)} evaluations could not be confirmed: {wrong[0].wrong}")
    total, same = sum(o.rows for o in outcomes), sum(o.equal for o in outcomes)
    apart = sum(bool(outcome.apart) for outcome in outcomes)
    rest = f"all confirmed but for {apart} that only their own processor repeats" if apart else "all confirmed"
    console.say(f"{total} rows of {len(outcomes)} evaluations flown again: {same} with the same bits, {rest}")


def root(text: str) -> Path:
    """The store that ``runs=FOLDER`` names. Raises ConfigError for anything else."""
    from formctl.errors import ConfigError

    key, _, folder = text.partition("=")
    if key != "runs" or not folder:
        raise ConfigError(f"cannot read {text!r}: write runs=FOLDER")
    return Path(folder)


def nothing(place: Path) -> str:
    """What to say of a store without runs, or of a folder that is not there."""
    return f"no runs in {place}/ yet; formctl train makes one" if place.is_dir() else f"there is no store {place}/"


def known(value: str | None, choices: tuple[str, ...], option: str) -> None:
    """Raise ConfigError for a filter that can never match."""
    from formctl.errors import ConfigError

    if value is not None and value not in choices:
        raise ConfigError(f"{option} {value} is none of {', '.join(choices)}")


def line(run: "Run") -> list[str]:
    """A run as a line of the list."""
    record = run.view()
    parts = [str(record[key]) for key in ("id", "kind", "name", "status", "profile")]
    return [
        *parts,
        f"{record['minutes']:.1f}",
        ",".join(record.get("tags", [])),
        record["error"] or digest(record),
    ]


def digest(record: dict[str, Any]) -> str:
    """Who flew where, in an evaluation, and the figures people look for first."""
    figures = []
    for key, label in (("sr", "SR"), ("cfr", "CFR"), ("fm", "FM"), ("steps", "steps")):
        value = record["result"].get(key)
        if value is not None:
            figures.append(f"{label} {value:,}" if isinstance(value, int) else f"{label} {value:.3f}")
    who = f"{record['method']['name']} in {record['scenario']}" if record["kind"] == "eval" else ""
    return ": ".join(part for part in (who, ", ".join(figures)) if part)
