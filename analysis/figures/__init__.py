"""Figures in one look: each takes plain frames or arrays and gives a matplotlib figure; ``write`` saves them."""

from analysis.figures.behaviour import behaviour_data, draw_behaviour, draw_episode
from analysis.figures.diversity import draw_diversity
from analysis.figures.learning import draw_learning, period_starts
from analysis.figures.robustness import draw_robustness
from analysis.figures.simplex import draw_ranking, draw_simplex
from analysis.figures.style import Look, Plate, looks, write
from analysis.figures.sweep import draw_sweep
from analysis.figures.topview import Flight, draw_topview, flight_data

__all__ = [
    "Flight",
    "Look",
    "Plate",
    "behaviour_data",
    "draw_behaviour",
    "draw_diversity",
    "draw_episode",
    "draw_learning",
    "draw_ranking",
    "draw_robustness",
    "draw_simplex",
    "draw_sweep",
    "draw_topview",
    "flight_data",
    "looks",
    "period_starts",
    "write",
]
