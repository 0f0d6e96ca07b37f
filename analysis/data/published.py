"""What arXiv 2410.18495 has published: its numbers, each with its place, its scenes and its ablations.

Rates were published without counts of successes; the counts follow from the number of episodes that the text gives
(planners 25, learnt methods 100, real flights ten; Sec. VI-A1, VI-D2). Sweeps, satisfaction rates and ablations appear
in the paper as pictures only: there is nothing to copy.
"""

from typing import Literal, NamedTuple

ARXIV = "2410.18495"
TITLE = "Multi-UAV Formation Control with Static and Dynamic Obstacle Avoidance via Reinforcement Learning"

METHODS = {"ours": "Ours", "swarm_rl": "Swarm-RL", "rmader": "R-MADER", "swarm_formation": "Swarm-Formation"}
"""The paper's methods in the order of the tables, and what it calls them."""

ENCODERS = {"attention": "Ours", "no_ca": "w/o CA", "no_sa": "w/o SA", "mlp": "MLP"}
"""Arms of the encoder ablation (Sec. VI-C1)."""

CURRICULA = {
    "three_period": "Ours",
    "three_period_dynamic": "3-period, dynamic",
    "two_period": "2-period",
    "none": "w/o CL",
}
"""Arms of the curriculum ablation (Sec. VI-C2)."""

LEARNER = "mappo"
"""The paper's learner (Sec. VI)."""

Axis = Literal["columns", "balls"]

SWEEPS: dict[Axis, tuple[str, tuple[int, ...]]] = {
    "columns": ("static", (5, 10, 15, 20)),
    "balls": ("dynamic", (1, 2, 3, 4, 5)),
}
"""Scenario and numbers of obstacles of the two sweeps, with none of the other kind (Sec. VI-A2)."""

REAL_SCENES = {
    "real_static": "Static: 2 columns",
    "real_dynamic": "Dynamic: 1 ball",
    "real_mixed": "Mixed: 2 columns, 1 ball",
}
"""Scenarios of the real flights and their names (Table II)."""

FLIGHTS = 10
"""Real flights per cell of Table II."""


class Published(NamedTuple):
    """One published cell."""

    method: str  # of METHODS
    scenario: str  # name in conf/scenario/
    cfr: float
    episodes: int
    fm: float | None  # m, mean over the successful episodes
    source: str

    @property
    def successes(self) -> int:
        """Successful episodes behind the rate."""
        return round(self.cfr * self.episodes)


_TABLE_1 = "Table I: 2 balls and 10 columns, simulation (Sec. VI-A2)"
_TABLE_2 = "Table II: real world (Sec. VI-D2)"

SIMULATION = (
    Published("ours", "mixed", 0.89, 100, 0.278, _TABLE_1),
    Published("swarm_rl", "mixed", 0.83, 100, 0.959, _TABLE_1),
    Published("rmader", "mixed", 0.20, 25, 4.052, _TABLE_1),
    Published("swarm_formation", "mixed", 0.08, 25, 1.353, _TABLE_1),
)
"""Table I."""

REAL = tuple(
    Published(method, scenario, cfr, FLIGHTS, None, _TABLE_2)
    for scenario, cells in {
        "real_static": {"ours": 0.7, "rmader": 0.6, "swarm_formation": 0.5},
        "real_dynamic": {"ours": 0.7, "rmader": 0.8, "swarm_formation": 0.3},
        "real_mixed": {"ours": 0.8, "rmader": 0.5, "swarm_formation": 0.3},
    }.items()
    for method, cfr in cells.items()
)
"""Table II."""


def published(method: str, scenario: str) -> Published | None:
    """The paper's cell for a method in a scenario; None where the paper gives no number."""
    return next((cell for cell in (*SIMULATION, *REAL) if (cell.method, cell.scenario) == (method, scenario)), None)
