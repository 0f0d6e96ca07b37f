"""Words that depend on a number."""


def counted(count: int, noun: str) -> str:
    """1 ball, 2 balls, 1,000 episodes."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"
