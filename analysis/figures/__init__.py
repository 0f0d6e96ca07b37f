"""Figures in one look: each takes plain frames or arrays and gives a matplotlib figure; ``style.write`` saves it."""

from analysis.figures.learning import learning
from analysis.figures.simplex import ranking, simplex
from analysis.figures.style import Look, Plate, looks, write
from analysis.figures.sweep import sweep
from analysis.figures.topview import Flight, flight_data, topview

__all__ = ["Flight", "Look", "Plate", "flight_data", "learning", "looks", "ranking", "simplex", "sweep", "topview", "write"]
