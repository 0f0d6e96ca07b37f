"""When a training reached a mark: the first of its judgements that is good enough, in steps and minutes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

JUDGED = ("judge/cfr", "judge/fm")


@dataclass(frozen=True)
class Mark:
    """What a training has to reach in one judgement: CFR at least, FM in m at most."""

    cfr: float
    fm: float

    def reached(self, row: Mapping[str, Any]) -> bool:
        """Whether a line of metrics.jsonl is a judgement that reaches the mark."""
        return all(key in row for key in JUDGED) and row["judge/cfr"] >= self.cfr and row["judge/fm"] <= self.fm


@dataclass(frozen=True)
class Learnt:
    """How one training went. Minutes include compiling and judging; steps and minutes are None short of the mark."""

    learner: str
    seed: int
    run: str
    steps: int | None
    minutes: float | None
    last_steps: int  # of the last judgement
    last_minutes: float
    best_cfr: float | None
    fm_at_best: float | None  # m, of the judgement with the best CFR


def learnt(learner: str, seed: int, run: str, rows: Sequence[Mapping[str, Any]], mark: Mark) -> Learnt:
    """What a training's metrics say about the mark."""
    judged = [row for row in rows if all(key in row for key in JUDGED)]
    first = next((row for row in judged if mark.reached(row)), None)
    best = max(judged, key=lambda row: (row["judge/cfr"], -row["judge/fm"]), default=None)
    end = judged[-1] if judged else {"steps": 0, "minutes": 0.0}
    return Learnt(
        learner,
        seed,
        run,
        None if first is None else int(first["steps"]),
        None if first is None else float(first["minutes"]),
        int(end["steps"]),
        float(end["minutes"]),
        None if best is None else float(best["judge/cfr"]),
        None if best is None else float(best["judge/fm"]),
    )
