"""``formctl compare``: two methods on the same episodes, from anybody's rows; a gate for regressions."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from analysis.stats.comparison import Comparison, Side

Rows = "A file of rows (.parquet or .csv), FILE:METHOD where it holds several, or an evaluation run."


def command(
    first: Annotated[str, typer.Argument(metavar="A", help=Rows)],
    second: Annotated[str, typer.Argument(metavar="B", help="The same; B is held against A.")],
    margin: Annotated[
        float, typer.Option(min=0, max=1, help="By how much B's rate may be below A's; beyond it the exit code is 1.")
    ] = 0.0,
    column: Annotated[str, typer.Option(help="The flag that is compared.")] = "cfr",
    across_banks: Annotated[
        bool, typer.Option("--across-banks", help="Pair equal numbers of different banks, drawn from one seed.")
    ] = False,
    runs: Annotated[Path, typer.Option(help="The output store.")] = Path("runs"),
) -> None:
    """Compare two methods on the same episodes: intervals, exact McNemar, paired difference.

    Exit code 1 where B is worse than A by more than the margin.

    Example: formctl compare before.parquet after.parquet --margin 0.02
    """
    from analysis.stats import comparison
    from formctl.errors import RunFailed

    sides = [side(text, column, runs) for text in (first, second)]
    found = comparison.compare(sides[0], sides[1], column, across_banks)
    show(found, sides[0], sides[1], column)
    if found.worse(margin):
        raise RunFailed(
            f"{sides[1].name} (B) is worse than {sides[0].name} (A): {column} {found.difference.value:+.3f} on "
            f"{found.shared} shared episodes, the margin is {margin:g}"
        )


def side(text: str, column: str, runs: Path) -> "Side":
    """The rows that A or B names. Raises ValueError, one line."""
    from analysis.stats import comparison
    from formctl import store

    file, colon, method = text.rpartition(":")
    if colon and Path(file).is_file():
        return comparison.read(Path(file), column, method)
    if Path(text).is_file() or text.endswith((".parquet", ".csv")):
        return comparison.read(Path(text), column)
    run = store.resolve(text, runs, kind="eval", holding="episodes.parquet")
    return comparison.read(run.path / "episodes.parquet", column)


def show(found: "Comparison", first: "Side", second: "Side", column: str) -> None:
    """The rates side by side, then what the pairs say."""
    from formctl import console

    lines = [
        (label, own.name, f"{rate.value:.3f} ({rate.k} of {rate.n})", f"{rate.low:.3f} to {rate.high:.3f}")
        for label, own, rate in (("A", first, found.first), ("B", second, found.second))
    ]
    console.table(("", "method", column, "95 % interval"), lines)
    change = found.difference
    console.say(f"B - A: {change.value:+.3f}, 95 % interval {change.low:+.3f} to {change.high:+.3f} (paired)")
    p = "p < 0.001" if found.p < 0.001 else f"p = {found.p:.3f}"
    console.say(
        f"{found.shared} shared episodes: only A succeeded in {found.only_first}, only B in {found.only_second} "
        f"(exact McNemar, {p})"
    )
    if found.fm is not None:
        fm = found.fm
        console.say(f"FM, both succeeded: B - A {fm.value:+.3f} m, 95 % interval {fm.low:+.3f} to {fm.high:+.3f}")
    if found.left_out:
        console.say(f"left out: {found.left_out} episodes that only one of them flew")
