"""formctl: from reward-weight search to the report, multi-UAV formation control with obstacle avoidance."""

__version__ = "0.1.0"
