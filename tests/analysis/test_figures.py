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

from analysis import evidence, figures, plates, rows, series, stats
from analysis.evidence import Evidence
from analysis.figures import style
from analysis.figures.learning import period_starts
from analysis.figures.simplex import barycentric
from analysis.report import Report
from tests.analysis.synthetic import Made, episodes, log_lines, trials


def flight(balls: int = 1) -> figures.Flight:
    times = np.linspace(0, 18, 91)
    offsets = np.array([[1.0, 0, 1.5], [-0.5, 0.87, 1.5], [-0.5, -0.87, 1.5]])
    positions = offsets + np.stack([0 * times, 2 * times, 0 * times], axis=1)[:, None]
    arcs = np.full((91, balls, 3), np.nan)
    arcs[20:28] = np.linspace([3, 8, 1], [-3, 12, 1], 8)[:, None]
    return figures.Flight(times, positions, np.array([[0.25, 9.0]]), arcs, hits=[(5.0, 1, "ball")])


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


def test_a_sweep_says_who_was_late_and_did_not_collide(made: Made) -> None:
    def point(balls: int, success: float, late: int) -> pd.DataFrame:
        frame = episodes(20, success, scenario="dynamic", columns=0, balls=balls)
        return frame.assign(failure=np.where(frame["cfr"], "", ["late"] * late + ["ball"] * (20 - late)))

    slow, struck, able = ("hover", {1: 19, 2: 18, 3: 10}), ("straight_line", {1: 9}), ("swarm_rl", {1: 20})
    for (name, points), success in ((slow, 0.0), (struck, 0.0), (able, 1.0)):
        made.evaluation(made.baseline(name), [point(balls, success, late) for balls, late in points.items()])
    found = evidence.gather(rows.load(made.root))
    (plate,) = plates.sweeps(found, "balls")
    assert isinstance(plate, figures.Plate) and plate.caption.count(" late.") == 1
    assert "Hover at 1 and 2 balls: 37 of 40 failed by being late." in plate.caption
    (world,) = series.sweep_worlds(found, "balls")
    made.evaluation(made.baseline("hover"), point(2, 1.0, 0))
    (note,) = series.late(evidence.gather(rows.load(made.root)), "balls", world)
    assert note == "Hover at 1 ball: 19 of 20 failed by being late."


def test_a_sweeps_points_are_the_rows(full: Evidence) -> None:
    (world,) = series.sweep_worlds(full, "balls")
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
    assert not series.sweep_worlds(evidence.gather(rows.load(made.root)), "balls")
    made.evaluation(made.baseline("straight_line"), ten)
    found = evidence.gather(rows.load(made.root))
    (world,) = series.sweep_worlds(found, "balls")
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
        labels_inside(figures.draw_topview(flight(), "A title", "a stamp"))


def test_methods_keep_their_look_and_stay_apart() -> None:
    names = [f"m{n}" for n in range(8)]
    looks = figures.looks(names, floor=["m7"])
    assert len({(look.color, look.marker, str(look.line)) for look in looks.values()}) == 8
    assert len({(look.color, look.marker) for look in looks.values()}) == 8  # points without a line stay apart too
    assert figures.looks(names[:3])["m1"] == looks["m1"]


def test_two_sets_of_a_planner_share_a_colour_and_stay_apart() -> None:
    looks = figures.looks(["a", "b", "b, fair", "c"], sets={"b, fair": "b"})
    assert looks["b"].color == looks["b, fair"].color not in (looks["a"].color, looks["c"].color)
    assert looks["b"].marker != looks["b, fair"].marker
    assert looks["b"].line != looks["b, fair"].line


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
        figures.draw_simplex(wrong, "")


@pytest.mark.parametrize("count", [1, 3, 40])
def test_any_number_of_trials_can_be_drawn(count: int) -> None:
    table = trials(count).assign(sr_low=0.1, sr_high=0.9)
    figures.draw_simplex(table, "").draw_without_rendering()
    figures.draw_ranking(table, "").draw_without_rendering()


def test_periods_are_marked_only_where_trainings_agree() -> None:
    one = pd.read_json(StringIO(log_lines(0, 60_000)), lines=True).assign(train_run="a")
    other = pd.read_json(StringIO(log_lines(1, 60_000)), lines=True).assign(train_run="b")
    assert [name for name, _ in period_starts(pd.concat([one, other]))] == ["free", "static", "mixed"]
    assert period_starts(pd.concat([one, other.assign(period="mixed")])) == []


def test_a_flight_is_checked() -> None:
    good = flight()
    with pytest.raises(ValueError, match="a flight needs times"):
        figures.Flight(good.times[:-1], good.positions, good.columns, good.balls)


@pytest.mark.parametrize("balls", [0, 1, 3])
def test_topview_of_any_number_of_balls(balls: int) -> None:
    seen = flight(balls)
    figures.draw_topview(seen).draw_without_rendering()
    data = figures.flight_data(seen)
    assert len(data) == 3 * 91 + 8 * balls
    assert set(data["body"]) == {f"drone {n}" for n in range(3)} | {f"ball {n}" for n in range(balls)}
