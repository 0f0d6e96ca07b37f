"""CFR at other goal lines, from times by hand and from the stored rows of the reference."""

from pathlib import Path

import numpy as np

from analysis import report
from analysis.data import evidence, lookup, rows
from analysis.tables import goal_lines
from tests.analysis.synthetic import Made, episodes

REFERENCE = Path(__file__).parents[3] / "runs" / "reference"
SETTINGS = {"eval": {"time_limit": 20.0}}


def test_in_time_and_clean_up_to_the_line(made: Made) -> None:
    frame = episodes(5, 1.0).assign(
        time_y30=[15.0, 15.0, 15.0, 20.0, np.nan],
        time_y40=[19.0, 19.0, 21.0, 22.0, np.nan],
        first_contact_time=[np.nan, 17.0, np.nan, np.nan, np.nan],  # the second hits something between the two lines
    )
    made.evaluation(made.baseline("hover"), frame, config=SETTINGS)
    found = evidence.gather(rows.load(made.root))
    table = goal_lines.table(found)
    assert table is not None and [column.title for column in table.columns[1:3]] == ["CFR, y = 30 m", "CFR, y = 40 m"]
    (line,) = table.rows
    assert [cell.value for cell in line[1:3]] == [4 / 5, 1 / 5]
    main = report.compose(found).sections[0]
    assert table in main.content


def test_rows_that_tell_no_times_give_no_table(made: Made) -> None:
    made.evaluation(made.baseline("hover"), episodes(5, 1.0), config=SETTINGS)
    assert goal_lines.table(evidence.gather(rows.load(made.root))) is None


def test_the_headline_line_gives_the_headline_rate() -> None:
    """At y = 34 m, the goal line, every stored episode of the main table is won exactly where its row says so."""
    found = evidence.gather(rows.load(REFERENCE))
    table = goal_lines.table(found)
    assert table is not None
    where = lookup.main_place(found)
    assert where is not None
    for method in found.expected:
        flown = found.rows(method, where)
        if flown is not None:
            assert (goal_lines.won(found, flown, "time_y34") == flown["cfr"]).all()
