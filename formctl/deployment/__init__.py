"""Towards real flights: exports, policies away from PyTorch, and episodes as a Crazyflie's set-points."""
