"""The weights that stage 2 starts from: the winner of the newest finished search of the same task."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import pandas as pd

from formctl import store
from formctl.search.trials import best, read_table, row_weights
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from envs.vocabulary import Weights
    from formctl.settings import Config
    from formctl.store import Run

TASK = ("drone", "observation", "reward")
"""Groups that give a weight vector its meaning, beside the search's own scenario."""


@dataclass(frozen=True)
class SearchWinner:
    """The chosen trial of a study."""

    run: "Run"
    trial: int
    weights: "Weights"
    sr: float
    fresh: bool  # whether ``sr`` is of episodes that no trial was chosen on

    @property
    def reference(self) -> str:
        """What ``weights=@REFERENCE`` takes."""
        return f"{self.run.path}/trial={self.trial}"

    @property
    def sentence(self) -> str:
        """``trial 17 of stage1, SR 0.91 on fresh episodes``."""
        episodes = "fresh episodes" if self.fresh else "the episodes that it was chosen on"
        return f"trial {self.trial} of {self.run.path.parent.name}, SR {self.sr:.2f} on {episodes}"


def newest_winner(config: "Config") -> SearchWinner | None:
    """The winner of the newest finished search in the store whose task is that of ``config``; None without any."""
    for run in store.scan(config.runs, kind="search", status="done"):
        tree = run.config
        same = all(tree.get(group) == config.tree[group] for group in TASK)
        if same and tree["search"]["scenario"] == config.tree["search"]["scenario"]:
            try:
                row = best(read_table(run.path))
            except StoreError:
                continue  # no trial of it can be read
            known = "sr_fresh" in row and bool(pd.notna(row["sr_fresh"]))
            rate = float(row["sr_fresh" if known else "sr"])
            return SearchWinner(run, int(row["trial"]), row_weights(row), rate, known)
    return None
