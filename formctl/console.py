"""What the user sees: messages, tables, progress. Imported by commands, never by the command line itself."""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from rich.console import Console
from rich.table import Table
from rich.text import Text

from formctl.errors import fail

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

__all__ = ["Bar", "Meter", "duration", "fail", "print_yaml", "progress", "say", "table", "track", "warn"]

T = TypeVar("T")

PLAIN_SECONDS = 10.0
"""Time between two progress lines where the output is not a terminal."""

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


def say(message: str) -> None:
    """One line of news on stdout."""
    out.print(message, soft_wrap=True, markup=False)


def warn(message: str) -> None:
    """One line on stderr about something that does not stop the run."""
    err.print(f"warning: {message}", style="yellow", soft_wrap=True, markup=False)


def table(columns: Sequence[str], rows: Iterable[Sequence[object]], title: str | None = None) -> None:
    """A table on stdout: drawn on a terminal, aligned columns of plain text otherwise, never cut off."""
    cells = [list(columns), *([str(cell) for cell in row] for row in rows)]
    if out.is_terminal:
        drawn = Table(*columns, title=title, title_justify="left")
        for row in cells[1:]:
            drawn.add_row(*map(Text, row))
        out.print(drawn)
        return
    if title:
        print(title)
    widths = [max(len(row[index]) for row in cells) for index in range(len(columns))]
    for row in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def print_yaml(tree: dict[str, Any]) -> None:
    """A nested dict as YAML, coloured on a terminal, ready to be piped otherwise."""
    import yaml
    from rich.syntax import Syntax

    text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)
    if out.is_terminal:
        out.print(Syntax(text, "yaml", background_color="default"))
    else:
        print(text, end="")


def duration(seconds: float) -> str:
    """``42 s``, ``7 min`` or ``3 h 05 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


class Meter:
    """Speed and time left, measured between updates: over the last minute, or the last quarter of the time so far.

    What comes before the first update (compiling) is no speed, and what is done in bursts minutes apart is averaged
    over several.
    """

    def __init__(self, total: float, start: float = 0, clock: Callable[[], float] = time.monotonic) -> None:
        self.total, self.done, self._clock = total, start, clock
        self._marks: deque[tuple[float, float]] = deque()
        self._began = 0.0  # at the first update

    def restart(self) -> None:
        """Measure anew from the next update on: what happened until then (compiling) says nothing about the speed."""
        self._marks.clear()

    def update(self, done: float) -> None:
        """Note that ``done`` of ``total`` are reached."""
        now = self._clock()
        self.done = done
        self._began = self._began if self._marks else now
        self._marks.append((now, done))
        since = now - max(60, (now - self._began) / 4)
        while len(self._marks) > 2 and self._marks[1][0] <= since:
            self._marks.popleft()

    @property
    def speed(self) -> float:
        """Units per second; 0 before the second update."""
        if len(self._marks) < 2:
            return 0.0
        (first, before), (last, after) = self._marks[0], self._marks[-1]
        return (after - before) / (last - first) if last > first else 0.0

    def text(self, unit: str) -> str:
        """``120,000 of 6,000,000 steps, 2,100 steps/s, 46 min left``."""
        parts = [f"{self.done:,.0f} of {self.total:,.0f} {unit}"]
        if self.speed > 0:
            rate = f"{self.speed:,.0f} {unit}/s" if self.speed >= 1 else f"{duration(1 / self.speed)} each"
            parts += [rate, f"{duration((self.total - self.done) / self.speed)} left"]
        return ", ".join(parts)


class Bar:
    """One line of progress: a bar on a terminal, a line of text every ten seconds otherwise."""

    def __init__(self, label: str, meter: Meter, unit: str, live: "Progress | None") -> None:
        self._label, self._meter, self._unit, self._live = label, meter, unit, live
        self._spoken, self._silent = time.monotonic(), True
        self._task: TaskID | None = None
        if live is not None:
            self._task = live.add_task(label, total=meter.total, completed=int(meter.done), text="", note="")

    def update(self, done: float, note: str = "") -> None:
        """``done`` of the total are reached; ``note`` says how it goes (period, loss, success so far)."""
        self._meter.update(done)
        text = self._meter.text(self._unit)
        if self._live is not None and self._task is not None:
            self._live.update(self._task, completed=done, text=text, note=note)
        elif time.monotonic() - self._spoken >= PLAIN_SECONDS:
            self._spoken = time.monotonic()
            print(f"{self._label}: {text}{', ' if note else ''}{note}", flush=True)

    def preparing(self, what: str) -> None:
        """Say what is being done while nothing advances; speed and time left are measured anew afterwards."""
        self._meter.restart()
        if self._live is not None and self._task is not None:
            self._live.update(self._task, text=what, note="")
        elif self._silent or time.monotonic() - self._spoken >= PLAIN_SECONDS:
            self._spoken = time.monotonic()
            print(f"{self._label}: {what}", flush=True)
        self._silent = False

    def advance(self, note: str = "") -> None:
        """One more is done."""
        self.update(self._meter.done + 1, note)

    def close(self) -> None:
        """Take the line off the terminal."""
        if self._live is not None and self._task is not None:
            self._live.remove_task(self._task)


_live: "Progress | None" = None  # rich draws one live region per terminal: nested bars share it


@contextmanager
def progress(label: str, total: float, unit: str = "steps", start: float = 0) -> Iterator[Bar]:
    """Show how far a long task is; ``start`` of ``total`` were already done (a resumed run). May be nested."""
    global _live
    outer = _live
    if not out.is_terminal:
        yield Bar(label, Meter(total, start), unit, None)
        return
    if outer is None:
        from rich.progress import BarColumn, Progress, TextColumn

        text = [
            TextColumn(f"{{task.{part}}}", markup=False) for part in ("description", "fields[text]", "fields[note]")
        ]
        _live = Progress(text[0], BarColumn(), *text[1:], console=out, transient=True)
        _live.start()
    bar = Bar(label, Meter(total, start), unit, _live)
    try:
        yield bar
    finally:
        bar.close()
        if outer is None and _live is not None:
            _live.stop()
            _live = None


def track(items: Sequence[T], label: str, unit: str) -> Iterator[T]:
    """Iterate with a progress bar."""
    with progress(label, len(items), unit) as bar:
        for item in items:
            yield item
            bar.advance()
