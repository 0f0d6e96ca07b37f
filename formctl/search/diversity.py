"""``formctl search --alike``: trials of like satisfaction rate in one and the same episode, behaving differently.

The paper shows diverse behaviours at similar rates (Sec. VI-B): weights decide how a team dodges where the rate does
not tell them apart.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from analysis.figures.behaviour import draw_behaviour
from analysis.recordings import merge, page
from envs.bank import Bank
from envs.vocabulary import OBJECTIVES
from formctl import store
from formctl.console import say
from formctl.evaluation import methods, recorder
from formctl.evaluation.scenes import EvaluationScene
from formctl.search import winner
from formctl.search.laws import PARAMETERS
from formctl.search.results import StudyView
from formctl.search.sensitivity import flown
from formctl.search.table import Row
from formctl.settings import build, restore
from formctl.store.files import StoreError, atomic, write_text
from formctl.viewers.files import write_mcap

SHOWN = 3
"""Trials in the picture, as in the paper's."""


def show(view: StudyView) -> None:
    """Fly the episode with every chosen trial; ``alike.png``, ``.html`` and ``.mcap`` in the study's folder.

    Raises StoreError where no trial satisfies, or none is like the best.
    """
    folder, trials = view.folder, view.rows()
    known = flown(folder, trials)
    chosen = most_different(alike([row for row in trials if row["trial"] in known]))
    number = closest_call([known[row["trial"]] for row in chosen])
    say(f"episode {number} of the study's bank, flown by {len(chosen)} trials of like SR")
    flights = [record(folder, row, number) for row in chosen]
    for row, flight in zip(chosen, flights, strict=True):
        say(f"{title(row)}: {recorder.sentence(flight.row)}")
    together = merge([flight.recording for flight in flights])
    stem = folder / "alike"
    with atomic(stem.with_suffix(".png")) as path:
        figure = draw_behaviour(together, f"study {view.name}", [title(row) for row in chosen])
        figure.savefig(path, dpi=200, format="png")
    write_text(stem.with_suffix(".html"), page.render(together))
    write_mcap(together, stem.with_suffix(".mcap"))
    say(f"picture: {stem.with_suffix('.png')}, page: {stem.with_suffix('.html')}")


def alike(trials: Sequence[Row]) -> list[Row]:
    """The trial of the highest SR and those that are not told from it. Raises StoreError where it stands alone."""
    found = winner.not_told_apart(trials)
    if not found[0]["sr_k"]:
        raise StoreError("no trial has satisfied all objectives in any episode: there are no behaviours to compare")
    if len(found) == 1:
        raise StoreError(f"trial {found[0]['trial']} stands alone: no other comes near its SR of {found[0]['sr']:.3f}")
    return found


def most_different(trials: Sequence[Row], count: int = SHOWN) -> list[Row]:
    """The first and those whose weights lie farthest from all that are chosen already, ``count`` in all."""
    points = np.array([[row[name] for name in PARAMETERS] for row in trials])
    chosen = [0]
    while len(chosen) < min(count, len(trials)):
        nearest = np.linalg.norm(points[:, None] - points[None, chosen], axis=-1).min(1)
        chosen.append(int(nearest.argmax()))
    return [trials[index] for index in chosen]


def closest_call(tables: Sequence[pd.DataFrame]) -> int:
    """The episode to look at: of those that every trial flew without a collision, the one with the closest balls."""
    safe = np.all([table["cfr"].to_numpy(bool) for table in tables], axis=0)
    gap = np.sum([np.nan_to_num(table["min_ball"].to_numpy(float), nan=1e3, posinf=1e3) for table in tables], axis=0)
    return int(np.where(safe, gap, gap + 1e6).argmin())


def record(folder: Path, row: Row, number: int) -> recorder.RecordedFlight:
    """Episode ``number`` of the study's bank, flown and recorded with a trial's policy."""
    policy = folder / str(row["policy"])
    config = restore(store.Run(policy.parent).config)
    build.use_threads(config)
    scene = EvaluationScene(build.world(config), Bank.load(folder / "bank.npz"))
    return recorder.record_episode(methods.policy(str(policy), config.runs), scene, number, config)


def title(row: Row) -> str:
    """A trial as the picture names it."""
    weights = ", ".join(f"{name} {row[f'w_{name}']:.2f}" for name in OBJECTIVES)
    return f"Trial {row['trial']}, SR {row['sr']:.2f}: {weights}"
