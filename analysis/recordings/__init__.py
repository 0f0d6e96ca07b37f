"""Recorded episodes: as numbers, as MCAP for Foxglove, as one HTML page, as pictures. No torch, no simulator."""

from analysis.recordings.failure_modes import Halt, Tear, modes
from analysis.recordings.record import Event, Plan, Recording, RecordingError, Scene, Throw, Trace, merge, same

__all__ = [
    "Event",
    "Halt",
    "Plan",
    "Recording",
    "RecordingError",
    "Scene",
    "Tear",
    "Throw",
    "Trace",
    "merge",
    "modes",
    "same",
]
