"""A sample of sentences for a reader to judge, by the strata of the review of November 2026."""

import random
from collections.abc import Iterator, Sequence

from testing.english.pages import LEAST_WORDS
from testing.english.sentences import sentences, word_count
from testing.english.texts import Source, Text

SHARES = {"docs": 60, "help": 30, "templates": 30, "errors and API": 30}
"""Sentences of each stratum in a sample of 150."""
HELP = ("stone_client/commands/", "stone_local/commands/")


def stratum_of(text: Text) -> str | None:
    """Return the stratum of a text; None for comments and for docstrings that no user reads."""
    if text.path.endswith(".md"):
        return "docs"
    if text.path.startswith("web/") and text.source in {Source.PAGE, Source.SCRIPT}:
        return "templates" if text.source is Source.PAGE else None
    if text.path.startswith(HELP) and text.source is not Source.COMMENT:
        return "help"
    if text.source is Source.STRING and not text.path.startswith(
        ("testing/", "benchmarks/", "chaos/", "fuzz/", "deploy/")
    ):
        return "errors and API"
    return None


def draw(texts: Sequence[Text], count: int, seed: int) -> Iterator[tuple[str, Text, str]]:
    """Yield `count` sentences as stratum, text and sentence, without replacement; the same seed draws the same ones."""
    pools = {stratum: list[tuple[Text, str]]() for stratum in SHARES}
    for text in texts:
        stratum = stratum_of(text)
        if stratum is not None:
            pools[stratum] += [(text, part) for part in sentences(text.words) if word_count(part) >= LEAST_WORDS]
    generator = random.Random(seed)
    for stratum, share in SHARES.items():
        pool = pools[stratum]
        for text, sentence in generator.sample(pool, min(len(pool), count * share // sum(SHARES.values()))):
            yield stratum, text, sentence
