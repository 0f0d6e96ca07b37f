"""One look for every figure: IEEE widths, a typeface that matplotlib ships, colours that every reader can tell apart.

Figures are made without pyplot: no global state, no display, the same bytes every time.
"""

import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.rcsetup import cycler
from PIL import Image
from PIL.PngImagePlugin import PngInfo

COLUMN = 3.5
"""Width of an IEEE column, inches."""
DOUBLE = 7.16
"""Width of both columns, inches."""
DPI = 300
SETTLED = 20_000  # pixels, of one to six million
DIGITS = "%.9g"
"""Of numbers beside a figure: as many as tell any two of float32 apart."""

INK = "#222222"
FAINT = "#8a8a8a"
GRID = "#e4e4e4"
SEQUENTIAL = "viridis_r"
"""For rates: lightness alone carries the order, the same to every eye; the darker, the higher (as in the paper)."""

# Okabe and Ito's palette without the pale yellow, which vanishes on white; then Tol's muted one, as far as it differs.
PALETTE = (
    *("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"),
    *("#332288", "#882255", "#999933", "#44AA99", "#661100", "#AA4499"),
)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h", "*")
DRONES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
BALL = "#B2182B"
COLUMN_FILL = "#555555"

RC: dict[Any, Any] = {
    "font.family": ["STIXGeneral"],
    "mathtext.fontset": "stix",
    "font.size": 8.5,
    "axes.labelsize": 8.5,
    "axes.titlesize": 8.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "axes.prop_cycle": cycler(color=PALETTE),
    "lines.linewidth": 1.3,
    "lines.markersize": 4,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "figure.dpi": 100,
    "savefig.dpi": DPI,
}


class LineStyle(NamedTuple):
    """How one method is drawn: the same in every figure of a report."""

    color: str
    marker: str
    line: Any


@dataclass(frozen=True)
class ReportFigure:
    """A finished figure with the data behind it, ready to be written."""

    key: str  # file name
    title: str
    caption: str
    figure: Figure
    data: pd.DataFrame
    stamp: str
    double: bool = False


def line_styles(names: Sequence[str], floor: Sequence[str] = ()) -> dict[str, LineStyle]:
    """A style for every name, in order, no colour twice before all are used; names of ``floor`` are grey and dashed.

    floor: agents that avoid nothing.
    """
    strong = [name for name in names if name not in floor]
    found = {}
    for n, name in enumerate(strong):
        again, hue = divmod(n, len(PALETTE))
        found[name] = LineStyle(PALETTE[hue], MARKERS[(hue + again) % len(MARKERS)], "-." if again else "-")
    greys = ("#7a7a7a", "#b0b0b0", "#555555")
    for n, name in enumerate(floor):
        found[name] = LineStyle(greys[n % 3], ("x", "+", "1")[n % 3], (0, (4, 2)))
    return {name: found[name] for name in names}


def legend_columns(names: Sequence[str], width: float) -> int:
    """How many of the names fit side by side into a legend of ``width`` inches."""
    return max(1, min(len(names), int(22 * width / (11 + max(map(len, names), default=1)))))


@contextmanager
def styled() -> Iterator[None]:
    """Matplotlib in the house style while the block lasts."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(RC)
        yield


def new(width: float, height: float) -> Figure:
    """An empty figure that lays itself out; inches."""
    return Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.03, h_pad=0.03))


def put_stamp(figure: Figure, text: str) -> None:
    """Small print below everything: profile, budget, seeds, episodes, commit; wrapped to the figure's width."""
    letters = int(figure.get_figwidth() * 30)
    figure.supxlabel("\n".join(textwrap.wrap(text, letters)), fontsize=5.5, color=FAINT, x=0.01, ha="left")


def settle(figure: Figure) -> Figure:
    """Lay the figure out once and for all, so that it looks the same wherever and however often it is saved."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    return figure


def write(drawn: ReportFigure, folder: Path) -> list[Path]:
    """Write ``<key>.pdf``, ``.png`` and ``.csv`` (first line: the stamp, as a comment); the same bytes every time."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{drawn.key}.{ending}" for ending in ("pdf", "png", "csv")]
    with styled():
        drawn.figure.savefig(paths[0], metadata={"CreationDate": None, "Title": drawn.title, "Subject": drawn.stamp})
        _write_png(drawn, paths[1])
    with paths[2].open("w", encoding="utf-8", newline="") as file:
        file.write(f"# {drawn.stamp}\n")
        drawn.data.to_csv(file, index=False, float_format=DIGITS)
    return paths


def _write_png(drawn: ReportFigure, path: Path) -> None:
    """The picture with a palette of its own 256 colours: a third of the size of one without.

    Maximum coverage finds a colour near every pixel's, however few pixels have it, and k-means moves those to what the
    figure mostly has, until no more than SETTLED pixels change theirs. Without dithering what is even stays even.
    """
    canvas, usual = FigureCanvasAgg(drawn.figure), drawn.figure.dpi
    drawn.figure.set_dpi(DPI)
    canvas.draw()
    drawn.figure.set_dpi(usual)
    pixels = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture = pixels.quantize(256, Image.Quantize.MAXCOVERAGE, SETTLED, dither=Image.Dither.NONE)
    text = PngInfo()
    text.add_text("Description", drawn.stamp)
    picture.save(path, pnginfo=text, dpi=(DPI, DPI))
