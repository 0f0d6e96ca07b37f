"""Where each drone is sent: its vertex of the formation at the destination, along its own straight line.

Destinations are 36 m away, three times the size of the room that Swarm-RL was made for: raw displacements would drown
every other input and cost. A drone is therefore shown the point of its line that lies ``carrot`` m ahead of it, and the
destination itself when that is nearer. Nothing in it refers to the clock or to the others.
"""

import torch
from torch import Tensor

from envs.spec import ScenarioSpec


def displacement(position: Tensor, slots: Tensor, scenario: ScenarioSpec, carrot: float, beyond: float) -> Tensor:
    """Drone minus goal (E, N, 3) in m, world frame, of drones at ``position`` (E, N, 3).

    The rearmost of the ``slots`` (N, 3) has its destination ``beyond`` m past the goal line.
    """
    ahead = scenario.goal + beyond - slots[:, 1].min() - scenario.start[1]
    home = slots.new_tensor((*scenario.start[:2], scenario.height))
    offset = position - (home + slots)
    along = (offset[..., 1] - ahead).clamp(-carrot, carrot)
    return torch.stack((offset[..., 0], along, offset[..., 2]), -1)
