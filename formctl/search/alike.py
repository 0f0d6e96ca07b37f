"""``formctl search --alike``: trials of like satisfaction rate in one and the same episode, behaving differently.

The paper shows diverse behaviours at similar rates (Sec. VI-B): weights decide how a team dodges where the rate does
not tell them apart.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis import stats
from formctl.search import choosing, overview
from formctl.search.ledger import Ledger
from formctl.search.sensitivity import episodes
from formctl.search.trials import PARAMETERS
from formctl.store.files import StoreError, atomic

if TYPE_CHECKING:
    import pandas as pd

    from formctl.evaluation.recorder import RecordedFlight
    from formctl.store import Run

SHOWN = 3
"""Trials in the picture, as in the paper's."""

Row = Mapping[str, Any]


def show(run: "Run", study: Ledger) -> None:
    """Fly the episode with every chosen trial; ``alike.png``, ``.html`` and ``.mcap`` in the study's folder.

    Raises StoreError where no trial satisfies, or none is like the best.
    """
    from analysis.figures.behaviour import draw_behaviour
    from analysis.recordings import merge, page
    from formctl import console
    from formctl.evaluation import recorder
    from formctl.store.files import write_text
    from formctl.viewers.files import write_mcap

    known = episodes(run, study)
    chosen = apart(like([row for row in overview.top(study, 1_000_000) if row["trial"] in known]))
    number = telling([known[row["trial"]] for row in chosen])
    console.say(f"episode {number} of the study's bank, flown by {len(chosen)} trials of like SR")
    flights = [fly(run, row, number) for row in chosen]
    for row, flight in zip(chosen, flights, strict=True):
        console.say(f"{title(row)}: {recorder.sentence(flight.row)}")
    together = merge([flight.recording for flight in flights])
    stem = run.path / "alike"
    with atomic(stem.with_suffix(".png")) as path:
        figure = draw_behaviour(together, f"study {run.path.parent.name}", [title(row) for row in chosen])
        figure.savefig(path, dpi=200, format="png")
    write_text(stem.with_suffix(".html"), page.render(together))
    write_mcap(together, stem.with_suffix(".mcap"))
    console.say(f"picture: {stem.with_suffix('.png')}, page: {stem.with_suffix('.html')}")


def like(rows: Sequence[Row]) -> list[Row]:
    """The trials that cannot be told from the first, the best: their SR is within its 95 % interval."""
    best = rows[0]
    if not best["sr_k"]:
        raise StoreError("no trial has satisfied all objectives in any episode: there are no behaviours to compare")
    low, _ = stats.wilson(best["sr_k"], best["sr_n"])
    found = [row for row in rows if row["sr"] >= low]
    if len(found) == 1:
        raise StoreError(f"trial {best['trial']} stands alone: no other trial comes near its SR of {best['sr']:.3f}")
    return found


def apart(rows: Sequence[Row], count: int = SHOWN) -> list[Row]:
    """The first and those whose weights lie farthest from all that are chosen already, ``count`` in all."""
    points = np.array([[row[name] for name in PARAMETERS] for row in rows])
    chosen = [0]
    while len(chosen) < min(count, len(rows)):
        nearest = np.linalg.norm(points[:, None] - points[None, chosen], axis=-1).min(1)
        chosen.append(int(nearest.argmax()))
    return [rows[index] for index in chosen]


def telling(tables: "Sequence[pd.DataFrame]") -> int:
    """The episode to look at: of those that every trial flew without a collision, the one with the closest balls."""
    safe = np.all([table["cfr"].to_numpy(bool) for table in tables], axis=0)
    gap = np.sum([np.nan_to_num(table["min_ball"].to_numpy(float), nan=1e3, posinf=1e3) for table in tables], axis=0)
    return int(np.where(safe, gap, gap + 1e6).argmin())


def fly(run: "Run", row: Row, number: int) -> "RecordedFlight":
    """Episode ``number`` of the study's bank, flown and recorded with a trial's policy."""
    from envs.bank import Bank
    from formctl import store
    from formctl.evaluation import methods, recorder
    from formctl.evaluation.scenes import EvaluationScene
    from formctl.settings import build, restore

    policy = run.path / str(row["policy"])
    config = restore(store.Run(policy.parent).config)
    build.use_threads(config)
    scene = EvaluationScene(build.world(config), Bank.load(run.path / "bank.npz"))
    return recorder.record_episode(methods.policy(str(policy), Path(config.runs)), scene, number, config)


def title(row: Row) -> str:
    """A trial as the picture names it."""
    weights = ", ".join(f"{name} {row[f'w_{name}']:.2f}" for name in choosing.OBJECTIVES)
    return f"Trial {row['trial']}, SR {row['sr']:.2f}: {weights}"
