from io import StringIO
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from analysis import stats
from analysis.data import evidence, lookup, rows
from analysis.data.evidence import Evidence
from analysis.figures import report_figures, series, style
from analysis.figures.learning import period_starts
from analysis.figures.simplex import barycentric, draw_ranking, draw_simplex
from analysis.figures.style import ReportFigure
from analysis.figures.topview import DrawnFlight, draw_topview, flight_data
from analysis.report import Report
from tests.analysis.synthetic import Made, episodes, log_lines, trials


def flight(balls: int = 1) -> DrawnFlight:
    times = np.linspace(0, 18, 91)
    offsets = np.array([[1.0, 0, 1.5], [-0.5, 0.87, 1.5], [-0.5, -0.87, 1.5]])
    positions = offsets + np.stack([0 * times, 2 * times, 0 * times], axis=1)[:, None]
    arcs = np.full((91, balls, 3), np.nan)
    arcs[20:28] = np.linspace([3, 8, 1], [-3, 12, 1], 8)[:, None]
    return DrawnFlight(times, positions, np.array([[0.25, 9.0]]), arcs, hits=[(5.0, 1, "ball")])


def test_files_exist_and_the_csv_is_the_data(page: Report, folder: Path) -> None:
    keys = []
    for plate in page.figures():
        pdf, png, csv = (folder / "figures" / f"{plate.key}.{ending}" for ending in ("pdf", "png", "csv"))
        keys.append(plate.key)
        assert pdf.read_bytes().startswith(b"%PDF") and b"/Type3" not in pdf.read_bytes()
        width = style.DOUBLE if plate.double else style.COLUMN
        assert Image.open(png).size[0] == round(width * style.DPI)
        assert csv.read_text(encoding="utf-8").splitlines()[0] == f"# {plate.stamp}"
        read = pd.read_csv(csv, comment="#")
        numbers = plate.data.select_dtypes("number")
        pd.testing.assert_frame_equal(read[numbers.columns], numbers.reset_index(drop=True), check_dtype=False)
        assert "profile laptop" in plate.stamp
    assert keys[:4] == ["sweep_columns", "sweep_balls", "simplex", "ranking"]  # no flight was recorded in this store
    assert keys[4:] == ["learning", "learning_encoder", "learning_curriculum"]


def test_a_palette_is_small_and_cannot_be_seen(page: Report, folder: Path, tmp_path: Path) -> None:
    plates = {plate.key: plate for plate in page.figures()}
    for key in ("sweep_columns", "simplex", "learning"):  # bands, a colour scale, many pale lines
        whole, file = tmp_path / f"{key}.png", folder / "figures" / f"{key}.png"
        with style.styled():
            plates[key].figure.savefig(whole)
        assert file.stat().st_size < 0.45 * whole.stat().st_size
        written = Image.open(file)
        assert written.mode == "P" and written.info["Description"] == plates[key].stamp
        drawn, seen = (np.asarray(image.convert("RGB"), dtype=int) for image in (Image.open(whole), written))
        assert (np.abs(seen - drawn).max(-1) > 24).sum() == 0 and np.abs(seen - drawn).mean() < 0.3
        paper = (drawn == 255).all(-1)
        assert (seen[paper] == 255).all()


def test_a_sweep_says_who_was_late_and_how_slow(made: Made) -> None:
    def point(balls: int, late: int, speed: float) -> pd.DataFrame:
        frame = episodes(20, 0.0, scenario="dynamic", columns=0, balls=balls)
        return frame.assign(failure=["late"] * late + ["ball"] * (20 - late), mean_speed=speed)

    slow, struck, still = ("rmader", 15, 1.3), ("swarm_formation", 9, 1.3), ("hover", 20, 0.0)
    for name, late, speed in (slow, struck, still):
        made.evaluation(made.baseline(name), [point(balls, late, speed) for balls in (1, 2)])
    (drawn,) = report_figures.sweeps(evidence.gather(rows.load(made.root)), "balls")
    assert isinstance(drawn, ReportFigure)
    said = "Past the time limit without touching anything: R-MADER in 30 of 40, at 1.30 m/s on average."
    assert said in drawn.caption and drawn.caption.count("time limit") == 1


def test_a_sweeps_points_are_the_rows(full: Evidence) -> None:
    (world,) = lookup.sweep_worlds(full, "balls", series.LEAST)
    points = series.sweep(full, "balls", world)
    ours = points[points["method"] == "Ours, MAPPO"]
    assert ours["obstacles"].tolist() == [1, 2, 3, 4, 5]
    for _, point in points[points["method"] == "Swarm-RL"].iterrows():
        (rows,) = [
            r
            for (key, w), r in full.cells.items()
            if "swarm_rl" in key and w.scenario == "dynamic" and w.balls == point["obstacles"]
        ]
        assert point["cfr"] == rows["cfr"].mean()
        assert (point["cfr_low"], point["cfr_high"]) == stats.wilson(int(rows["cfr"].sum()), len(rows))
        assert point["fm"] == pytest.approx(rows.loc[rows["cfr"], "fm"].mean())
    assert points.loc[points["k"] == 0, "fm"].isna().all()


def test_a_recorded_flight_is_no_point_of_a_sweep(made: Made) -> None:
    one, ten = (episodes(count, 0.5, scenario="dynamic", columns=0, balls=2) for count in (1, series.LEAST))
    made.evaluation(made.baseline("hover"), one)
    assert not lookup.sweep_worlds(evidence.gather(rows.load(made.root)), "balls", series.LEAST)
    made.evaluation(made.baseline("straight_line"), ten)
    found = evidence.gather(rows.load(made.root))
    (world,) = lookup.sweep_worlds(found, "balls", series.LEAST)
    assert series.sweep(found, "balls", world)["method"].tolist() == ["Straight line"]


def ticks(axes: Axes) -> list[Text]:
    """Labels of the ticks that are drawn: those within the view."""
    across, up = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    along = [label for label in axes.get_xticklabels() if across[0] <= label.get_position()[0] <= across[1]]
    return along + [label for label in axes.get_yticklabels() if up[0] <= label.get_position()[1] <= up[1]]


def labels_inside(figure: Figure) -> None:
    """Every text of a figure lies within it, and no two of an axis's tick labels touch."""
    figure.draw_without_rendering()
    page = figure.bbox
    for axes in figure.axes:
        for text in (*axes.texts, axes.title, axes.xaxis.label, axes.yaxis.label, *ticks(axes)):
            if text.get_text() and text.get_visible():
                box = text.get_window_extent()
                assert box.x0 >= page.x0 - 1 and box.x1 <= page.x1 + 1, text.get_text()
                assert box.y0 >= page.y0 - 1 and box.y1 <= page.y1 + 1, text.get_text()
        shown = [text.get_window_extent() for text in ticks(axes) if text.get_text() and text.get_visible()]
        for one, other in combinations(shown, 2):
            assert not one.padded(-1).overlaps(other.padded(-1))


def test_no_label_is_cut_off_or_overprinted(page: Report) -> None:
    with style.styled():
        for plate in page.figures():
            labels_inside(plate.figure)
        labels_inside(draw_topview(flight(), "A title", "a stamp"))


def test_a_ball_where_closest_says_how_far_above_or_below_it_is() -> None:
    seen = flight()
    gaps = np.linalg.norm(seen.positions - seen.balls[:, :1], axis=2)
    time, drone = np.unravel_index(np.nanargmin(gaps), gaps.shape)
    height = seen.balls[time, 0, 2] - seen.positions[time, drone, 2]
    texts = [text.get_text() for axes in draw_topview(seen).axes for text in axes.texts]
    assert f"{height:+.1f} m".replace("-", "−") in texts


def test_methods_keep_their_look_and_stay_apart() -> None:
    names = [f"m{n}" for n in range(8)]
    looks = style.line_styles(names, floor=["m7"])
    assert len({(look.color, look.marker, str(look.line)) for look in looks.values()}) == 8
    assert len({(look.color, look.marker) for look in looks.values()}) == 8  # points without a line stay apart too
    assert style.line_styles(names[:3])["m1"] == looks["m1"]


def test_no_two_methods_share_a_colour() -> None:
    styles = style.line_styles([f"m{n}" for n in range(len(style.PALETTE))])
    assert len({look.color for look in styles.values()}) == len(style.PALETTE)


@pytest.mark.parametrize("names", [["ab"] * 9, ["a method with a long name", "b", "c"], ["x" * 60, "y"]])
def test_a_legend_is_as_wide_as_its_figure_at_most(names: list[str]) -> None:
    with style.styled():
        figure = style.new(style.COLUMN, 3.0)
        axes = figure.subplots()
        for name in names:
            axes.plot([0], [0], label=name)
        ncols = style.legend_columns(names, style.COLUMN)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=ncols)
        style.settle(figure)
        width = figure.legends[0].get_window_extent().width / figure.dpi
    assert width <= style.COLUMN


def test_barycentric_corners() -> None:
    corners = barycentric(np.eye(3))
    assert corners == pytest.approx(np.array([[0.5, np.sqrt(3) / 2], [0, 0], [1, 0]]))
    assert barycentric(np.array([[2.0, 2.0, 2.0]])) == pytest.approx(corners.mean(axis=0, keepdims=True))


def test_weights_off_the_simplex_are_refused() -> None:
    wrong = trials(4).assign(w_action=0.9)
    with pytest.raises(ValueError, match="sum to 1"):
        draw_simplex(wrong, "")


@pytest.mark.parametrize("count", [1, 3, 40])
def test_any_number_of_trials_can_be_drawn(count: int) -> None:
    table = trials(count).assign(sr_low=0.1, sr_high=0.9)
    draw_simplex(table, "").draw_without_rendering()
    draw_ranking(table, "").draw_without_rendering()


def test_a_dot_stands_where_a_period_begins(page: Report) -> None:
    log = pd.read_json(StringIO(log_lines(0, 60_000)), lines=True)
    assert [name for name, _ in period_starts(log)] == ["free", "static", "mixed"]
    starts = [start for _, start in period_starts(log)]
    assert starts == [
        0.0,
        *(float(log.loc[log["period"] == name, "steps"].min() - 1000) for name in ("static", "mixed")),
    ]
    (figure,) = [drawn.figure for drawn in page.figures() if drawn.key == "learning"]
    dots = [line for line in figure.axes[0].get_lines() if line.get_marker() == "o"]
    assert dots and all(len(line.get_xdata()) == 2 for line in dots)  # type: ignore[arg-type]


@pytest.mark.parametrize("count", [2, 9])
def test_a_crowded_top_gets_a_panel_of_its_own(count: int) -> None:
    points = pd.DataFrame({"method": [f"m{n}" for n in range(count) for _ in range(2)], "obstacles": [5, 20] * count})
    points = points.assign(cfr=0.95, cfr_low=0.9, cfr_high=0.97, fm=0.2, fm_low=0.19, fm_high=0.21)
    figure = report_figures.draw_sweep(points, style.line_styles(list(points["method"].unique())), "x", "")
    assert len(figure.axes) == (3 if count > 2 else 2)


def test_an_axis_of_fm_is_linear_or_logarithmic_and_says_so() -> None:
    points = pd.DataFrame(
        {"method": ["a", "b", "c"], "obstacles": [5] * 3, "cfr": 0.5, "cfr_low": 0.4, "cfr_high": 0.6}
    )
    for values, scale in (([0.1, 0.2, 0.3], "linear"), ([0.05, 0.1, 9.0], "log")):
        figure = report_figures.draw_sweep(
            points.assign(fm=values, fm_low=values, fm_high=values), style.line_styles(["a", "b", "c"]), "x", ""
        )
        axes = figure.axes[-1]
        assert axes.get_yscale() == scale and ("log" in axes.get_ylabel()) == (scale == "log")


def test_a_flight_is_checked() -> None:
    good = flight()
    with pytest.raises(ValueError, match="a flight needs times"):
        DrawnFlight(good.times[:-1], good.positions, good.columns, good.balls)


@pytest.mark.parametrize("balls", [0, 1, 3])
def test_topview_of_any_number_of_balls(balls: int) -> None:
    seen = flight(balls)
    draw_topview(seen).draw_without_rendering()
    data = flight_data(seen)
    assert len(data) == 3 * 91 + 8 * balls
    assert set(data["body"]) == {f"drone {n}" for n in range(3)} | {f"ball {n}" for n in range(balls)}
