"""The world: batched, deterministic, differentiable formation flight of N drones through columns and thrown balls."""
