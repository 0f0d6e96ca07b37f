"""A*: shortest paths against Dijkstra, budgets, routes and corners in the map."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from baselines.swarm_formation import astar
from baselines.swarm_formation.scene import with_balls


def shortest(blocked, start, end):
    """Length in cells of the shortest path, by Dijkstra on the whole graph."""
    cells = np.argwhere(~blocked)
    number = np.full(blocked.shape, -1)
    number[tuple(cells.T)] = np.arange(len(cells))
    rows, columns, lengths = [], [], []
    for step in np.ndindex(3, 3, 3):
        move = np.array(step) - 1
        if not move.any():
            continue
        to = cells + move
        inside = ((to >= 0) & (to < blocked.shape)).all(-1)
        found = number[tuple(to[inside].T)]
        free = found >= 0
        rows.append(np.flatnonzero(inside)[free])
        columns.append(found[free])
        lengths.append(np.full(free.sum(), np.linalg.norm(move)))
    graph = coo_array((np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))))
    return dijkstra(graph.tocsr(), indices=number[start])[number[end]]


@pytest.mark.parametrize("seed", range(5))
def test_paths_are_shortest_free_and_connected(seed):
    blocked = np.random.default_rng(seed).random((12, 10, 6)) < 0.35
    start, end = (0, 0, 0), (11, 9, 5)
    blocked[start] = blocked[end] = False
    path = astar.search(blocked, start, end, 10**6)
    wanted = shortest(blocked, start, end)
    if np.isinf(wanted):
        assert len(path) == 0
        return
    steps = np.diff(path, axis=0)
    assert tuple(path[0]) == start and tuple(path[-1]) == end
    assert np.abs(steps).max() == 1 and not blocked[tuple(path.T)].any()
    assert np.linalg.norm(steps, axis=-1).sum() <= wanted * 1.0001 + 1e-9


def test_no_path_and_no_budget():
    blocked = np.zeros((9, 9, 9), bool)
    assert len(astar.search(blocked, (0, 0, 0), (8, 8, 8), 3)) == 0
    blocked[4] = True
    assert len(astar.search(blocked, (0, 0, 0), (8, 8, 8), 10**6)) == 0


def test_a_route_keeps_its_clearance_and_its_corners_see_each_other(scene):
    start, end = np.array([0.3, 1.0, 1.5]), np.array([0.3, 8.0, 1.5])
    path = astar.route(scene, start, end, 0.2, 50_000)
    assert path is not None
    corners = astar.shorten(scene, path, 0.2)
    assert np.array_equal(corners[0], path[0]) and np.array_equal(corners[-1], path[-1])
    assert len(corners) >= 3 and np.linalg.norm(np.diff(corners, axis=0), axis=-1).max() <= 3.0
    assert all(astar.visible(scene, a, b, 0.1) for a, b in pairwise(corners))
    assert not astar.visible(scene, start, end, 0.2)


def test_ends_in_a_column_are_pushed_outwards(scene):
    inside, end = np.array([0.3, 3.0, 1.5]), np.array([0.3, 8.0, 1.5])
    path = astar.route(scene, inside, end, 0.2, 50_000)
    assert path is not None
    assert np.array_equal(path[0], inside) and path[1][1] < 2.75
    back = astar.route(scene, end, inside, 0.2, 50_000)
    assert back is not None and back[-1][1] < 2.75


def test_a_ball_s_tube_is_gone_around(scene, ball):
    start, end = np.array([-1.9, 3.0, 1.5]), np.array([1.9, 1.0, 1.5])
    later = with_balls(scene, (ball,), 0.0)
    path = astar.route(later, start, end, 0.2, 50_000)
    assert path is not None
    gaps = np.linalg.norm(path[:, None] - later.curve, axis=-1).min()
    assert gaps > later.tube + 0.1
