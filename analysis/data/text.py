"""Words that depend on a number."""


def counted(count: int, noun: str) -> str:
    """1 ball, 2 balls, 1,000 episodes."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def short(count: int | None) -> str:
    """Training steps: 6.0 M, 250 k; an en dash for None."""
    if count is None:
        return "–"
    for unit, name in ((1_000_000_000, "G"), (1_000_000, "M"), (1_000, "k")):
        if count >= unit:
            return f"{count / unit:.3g} {name}"
    return str(count)


def span(texts: list[str]) -> str:
    """The first and the last of some texts in order; the only one."""
    return texts[0] if len(texts) == 1 else f"{texts[0]} to {texts[-1]}"
