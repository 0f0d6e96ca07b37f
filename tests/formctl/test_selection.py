"""Which episodes of an evaluation are recorded."""

import numpy as np
import pytest

from formctl.errors import ConfigError
from formctl.evaluation.selection import RecordingSelection, TopRecordings

ROWS = {
    "cfr": np.array([True, False, True, False, False]),
    "failure": np.array(["", "ball", "", "late", "column"], dtype=object),
    "first_contact_time": np.array([np.nan, 4.0, np.nan, np.nan, 2.5]),
    "fm": np.array([0.2, 1.0, 0.9, 0.3, 0.1]),
}
WANTED = {
    "worst=3": [4, 1, 3],  # the earliest collision, the later one, the late episode
    "worst=9": [4, 1, 3, 2, 0],  # then successes, the worst formation first
    "failed=2": [1, 3],
    "first=2": [0, 1],
    "ids=4,0": [0, 4],
}


@pytest.mark.parametrize("text", WANTED)
@pytest.mark.parametrize("size", [1, 2, 5])
def test_the_wanted_ones_are_kept_whatever_the_batches(text, size, tmp_path):
    recordings = TopRecordings(RecordingSelection.parse(text), tmp_path)
    for first in range(0, 5, size):
        part = {key: values[first : first + size] for key, values in ROWS.items()}
        watched = recordings.places(first, len(part["cfr"]))
        recordings.offer(part, first, lambda place, row, watched=watched: watched.index(place))
    assert [number for _, number, _ in recordings.ranked] == WANTED[text]


@pytest.mark.parametrize("text", ["worst", "worst=", "best=3", "first=1,2", "ids=x", "worst=-1", "failed=0"])
def test_choices_that_make_no_sense(text):
    with pytest.raises(ConfigError, match="cannot be used: write worst=5"):
        RecordingSelection.parse(text)


def test_an_episode_that_will_not_be_flown():
    RecordingSelection.parse("ids=4").check(5)
    with pytest.raises(ConfigError, match="--record ids=5: the episodes are 0 to 4"):
        RecordingSelection.parse("ids=1,5").check(5)
