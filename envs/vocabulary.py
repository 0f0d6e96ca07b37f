"""The words of the project, free of torch: what every package, table and figure calls things by."""

from collections.abc import Mapping

OBJECTIVES = ("formation", "flight", "obstacle", "action")
"""Order of the four objectives in every reward vector and weight vector (paper, Sec. V-A)."""

Weights = tuple[float, float, float, float]
"""Weights of the objectives, in their order; they sum to 1."""

CONTACTS = ("column", "ball", "drone", "ground", "ceiling")
"""Kinds of contact, in the order they are reported when several happen in one step."""

FAILURES = (*CONTACTS, "corridor", "late")
"""Why an episode fails: a contact, a drone that left the flight corridor, a goal that was not reached in time."""

METRIC_VERSION = 2
"""Raised whenever a column of the rows changes its meaning; rows of different versions are never pooled."""


def satisfaction(thresholds: Mapping[str, float]) -> str:
    """What an episode has to keep to count in SR, in words; ``thresholds`` are the settings ``eval`` (paper, Sec. V-B).

    It stands wherever a satisfaction rate is shown.
    """
    return (
        f"SR: FM < {thresholds['formation_threshold']:g} m; in time, inside the corridor, mean speed error < "
        f"{thresholds['speed_threshold']:g} m/s, mean height error < {thresholds['height_threshold']:g} m; no contact "
        f"at {thresholds['strict_radius']:g} m; mean throttle change < {thresholds['action_threshold']:g}"
    )
