"""Figures in one look: each takes plain frames or arrays and gives a matplotlib figure; ``style.write`` saves them."""
