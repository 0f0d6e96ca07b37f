"""Recorded episodes: as numbers, as MCAP for Foxglove, as one HTML page, as pictures. No torch, no simulator."""

from analysis.recordings.record import Event, Plan, Recording, RecordingError, Scene, Throw, Trace, merge, same

__all__ = ["Event", "Plan", "Recording", "RecordingError", "Scene", "Throw", "Trace", "merge", "same"]
