"""``formctl report``: the paper's tables and figures from whatever is in the store."""

from pathlib import Path
from typing import Annotated

import typer

from formctl.commands.options import StoreOption, StoreWords, split_words, store_of


def command(
    overrides: StoreWords = None,
    profile: Annotated[
        str | None, typer.Option(help="Show this profile; the most serious one with an evaluated policy otherwise.")
    ] = None,
    runs: StoreOption = None,
    out: Annotated[Path | None, typer.Option(help="Write to this folder instead of RUNS/report/PROFILE/ID.")] = None,
    readme: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Put the main table and a figure into this Markdown file.")
    ] = None,
    power: Annotated[
        str | None, typer.Option(metavar="RATE,RATE", help="Say how many episodes separate two rates, and stop.")
    ] = None,
) -> None:
    """The paper's tables and figures from whatever is in the store, the paper's numbers beside ours."""
    words = split_words(overrides, ("runs", "profile"))
    store = store_of([f"runs={words['runs']}"] if "runs" in words else None, runs)
    from formctl.stages import report

    if power is not None:
        report.show_power(power)
    else:
        report.write_report(store, profile=profile or words.get("profile"), out=out, readme=readme)
