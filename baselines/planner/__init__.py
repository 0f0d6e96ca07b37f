"""What trajectory planners share: their view of the world, their clock and messages, and the way to the drones."""
