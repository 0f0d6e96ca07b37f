"""One look for every figure: IEEE widths, a typeface that matplotlib ships, colours that every reader can tell apart.

Figures are made without pyplot: no global state, no display, the same bytes every time.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.rcsetup import cycler
from PIL import Image
from PIL.PngImagePlugin import PngInfo

if TYPE_CHECKING:
    import pandas as pd

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

# Okabe and Ito's palette; the pale yellow is left out, it vanishes on white.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = ("o", "s", "^", "D", "v", "P")
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


class Look(NamedTuple):
    """How one method is drawn: the same in every figure of a report."""

    color: str
    marker: str
    line: str


@dataclass(frozen=True)
class Plate:
    """A finished figure with the data behind it, ready to be written."""

    key: str  # file name
    title: str
    caption: str
    figure: Figure
    data: "pd.DataFrame"
    stamp: str
    double: bool = False


def looks(names: Sequence[str], floor: Sequence[str] = (), sets: Mapping[str, str] | None = None) -> dict[str, Look]:
    """A look for every name, in order; names of ``floor`` (agents that avoid nothing) are grey and dashed.

    ``sets`` maps a method with other parameters to the one whose colour it shares, both of them in ``names``.
    """
    sets = sets or {}
    strong = [name for name in names if name not in floor and name not in sets]
    found = {}
    for n, name in enumerate(strong):
        again, hue = divmod(n, len(PALETTE))
        found[name] = Look(PALETTE[hue], MARKERS[(hue + again) % len(MARKERS)], "-." if again else "-")
    for name, method in sets.items():
        hue = PALETTE.index(found[method].color)
        found[name] = Look(PALETTE[hue], MARKERS[(hue + 3) % len(MARKERS)], "-.")
    greys = ("#7a7a7a", "#b0b0b0", "#555555")
    found |= {name: Look(greys[n % 3], ("x", "+", "1")[n % 3], (0, (4, 2))) for n, name in enumerate(floor)}  # type: ignore[arg-type]
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
    import textwrap

    letters = int(figure.get_figwidth() * 30)
    figure.supxlabel("\n".join(textwrap.wrap(text, letters)), fontsize=5.5, color=FAINT, x=0.01, ha="left")


def settle(figure: Figure) -> Figure:
    """Lay the figure out once and for all, so that it looks the same wherever and however often it is saved."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    return figure


def write(plate: Plate, folder: Path) -> list[Path]:
    """Write ``<key>.pdf``, ``.png`` and ``.csv`` (first line: the stamp, as a comment); the same bytes every time."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{plate.key}.{ending}" for ending in ("pdf", "png", "csv")]
    with styled():
        plate.figure.savefig(paths[0], metadata={"CreationDate": None, "Title": plate.title, "Subject": plate.stamp})
        _write_png(plate, paths[1])
    with paths[2].open("w", encoding="utf-8", newline="") as file:
        file.write(f"# {plate.stamp}\n")
        plate.data.to_csv(file, index=False, float_format=DIGITS)
    return paths


def _write_png(plate: Plate, path: Path) -> None:
    """The picture with a palette of its own 256 colours: a third of the size of one without.

    Maximum coverage finds a colour near every pixel's, however few pixels have it, and k-means moves those to what the
    figure mostly has, until no more than SETTLED pixels change theirs. Without dithering what is even stays even.
    """
    canvas, usual = FigureCanvasAgg(plate.figure), plate.figure.dpi
    plate.figure.set_dpi(DPI)
    canvas.draw()
    plate.figure.set_dpi(usual)
    drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture = drawn.quantize(256, Image.Quantize.MAXCOVERAGE, SETTLED, dither=Image.Dither.NONE)
    text = PngInfo()
    text.add_text("Description", plate.stamp)
    picture.save(path, pnginfo=text, dpi=(DPI, DPI))
