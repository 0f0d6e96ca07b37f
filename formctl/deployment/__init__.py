"""Towards real flights: disturbances one at a time, and episodes as a Crazyflie's set-points."""
