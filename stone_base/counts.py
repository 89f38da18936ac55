"""Numbers with their noun, as people read them."""


def counted(count: int, noun: str, plural: str = "") -> str:
    """`1 sequence`, `12,345 frames`; `plural` where it is not the noun with an s."""
    return f"{count:,} {noun if count == 1 else plural or f'{noun}s'}"
