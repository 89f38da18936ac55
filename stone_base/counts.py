"""Numbers with their noun."""


def counted(count: int, noun: str, plural: str = "") -> str:
    """Return `1 sequence`, `12,345 frames` …; pass `plural` if it is not the noun plus "s"."""
    return f"{count:,} {noun if count == 1 else plural or f'{noun}s'}"
