"""Swarm-RL re-implemented: one network per drone from raw state to four rotor thrusts, 100 times a second.

Huang et al. 2023 (arXiv 2309.13285) on top of Batra et al., CoRL 2021 (arXiv 2109.07735), with the adaptations of the
paper: balls are observed, v* is tracked, and the goals are the vertices of the formation at the destination.

course       each drone's goal, and the point of its line that it is shown
observation  own state, nearest neighbours, signed distances to columns, nearest balls
network      the attention encoder as published, and smaller
reward       the published costs, and the velocity term
agent        the trained network as an agent

Annealing of the collision costs and replay of collisions belong to the learner: ``algos.ippo``, ``algos.replay``.
"""
