"""The published numbers of arXiv 2410.18495, each with the place it comes from.

Rates were published without counts of successes; the counts follow from the number of episodes that the text gives
("averaged over 25 different trials [planners], and RL-based methods over 100 trials"; real flights: "ten times").
Sweeps, satisfaction rates and ablations appear in the paper as pictures only: there is nothing to copy.
"""

from typing import NamedTuple

from analysis import stats

ARXIV = "2410.18495"
TITLE = "Multi-UAV Formation Control with Static and Dynamic Obstacle Avoidance via Reinforcement Learning"
TRAINING_STEPS = 315_000_000
"""Stage 2: 15 + 150 + 150 million environment steps (Sec. VI-A)."""


class Published(NamedTuple):
    """One published cell."""

    method: str  # ours | swarm_formation | rmader | swarm_rl
    scenario: str  # name in conf/scenario/
    cfr: float
    episodes: int
    fm: float | None  # m, mean over the successful episodes
    source: str

    @property
    def successes(self) -> int:
        """Successful episodes behind the rate."""
        return round(self.cfr * self.episodes)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the rate."""
        return stats.wilson(self.successes, self.episodes)


_TABLE_1 = "Table I (label table:simulation), 2 balls + 10 columns, simulation; {} trials (Sec. VI-A1)"
_TABLE_2 = "Table II (label table:real), real world, {}; ten flights (Sec. VI-D2)"

SIMULATION = (
    Published("ours", "mixed", 0.89, 100, 0.278, _TABLE_1.format(100)),
    Published("swarm_rl", "mixed", 0.83, 100, 0.959, _TABLE_1.format(100)),
    Published("rmader", "mixed", 0.20, 25, 4.052, _TABLE_1.format(25)),
    Published("swarm_formation", "mixed", 0.08, 25, 1.353, _TABLE_1.format(25)),
)
"""Table I."""

REAL = (
    Published("ours", "real_static", 0.7, 10, None, _TABLE_2.format("static (2 columns)")),
    Published("rmader", "real_static", 0.6, 10, None, _TABLE_2.format("static (2 columns)")),
    Published("swarm_formation", "real_static", 0.5, 10, None, _TABLE_2.format("static (2 columns)")),
    Published("ours", "real_dynamic", 0.7, 10, None, _TABLE_2.format("dynamic (1 ball)")),
    Published("rmader", "real_dynamic", 0.8, 10, None, _TABLE_2.format("dynamic (1 ball)")),
    Published("swarm_formation", "real_dynamic", 0.3, 10, None, _TABLE_2.format("dynamic (1 ball)")),
    Published("ours", "real_mixed", 0.8, 10, None, _TABLE_2.format("mixed (2 columns & 1 ball)")),
    Published("rmader", "real_mixed", 0.5, 10, None, _TABLE_2.format("mixed (2 columns & 1 ball)")),
    Published("swarm_formation", "real_mixed", 0.3, 10, None, _TABLE_2.format("mixed (2 columns & 1 ball)")),
)
"""Table II."""

METHODS = ("ours", "swarm_rl", "rmader", "swarm_formation")
"""The paper's methods, in the order of the tables."""


def published(method: str, scenario: str) -> Published | None:
    """The paper's cell for a method in a scenario; None where the paper gives no number."""
    return next((cell for cell in (*SIMULATION, *REAL) if (cell.method, cell.scenario) == (method, scenario)), None)
