"""Swarm-Formation (Quan et al., ICRA 2022; T-RO 2023), re-implemented from its published mathematics."""
