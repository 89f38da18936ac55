"""What pages, commands and docs say is in the field's words: private words do not come back."""

import re
from pathlib import Path

import pytest

from docsite.strings import ShownString, shown_strings

GLOSSARY = Path(__file__).resolve().parents[2] / "docs/glossary.md"
FORBIDDEN = re.compile(
    r"where can it go|what came of it|keeps time|sensors spoke|senses with|\b[TPN] taken for [TPN]\b|taken for what"
    r"|take it with you|\bfound it\b|leave it\b(?! its| out)|\bshut out\b|let in again|yours to know|heard yet"
    r"|not said\b|dry run|it stands on|nobody like|none is like|be scored by|how it did|bring new"
    r"|sign of life|surely differ",
    re.IGNORECASE,
)
# Names that programs read, in backticks, and templates' own comments are not what a user is told.
NAMES = re.compile(r"`[^`]*`")


@pytest.fixture(scope="module")
def shown() -> tuple[ShownString, ...]:
    return tuple(shown_strings())


def test_private_words_are_shown_nowhere(shown: tuple[ShownString, ...]) -> None:
    found = [f"{one.path}:{one.line}: {one.text}" for one in shown if FORBIDDEN.search(NAMES.sub("", one.text))]
    assert found == []


def test_each_kind_of_source_is_read(shown: tuple[ShownString, ...]) -> None:
    """A page, an attribute, a message, a title, a help, a script's text and a line of the docs, as users read them."""
    texts = {(one.path, one.text) for one in shown}
    for path, text in (
        ("web/templates/home.html", "3D traversability labels from field recordings"),
        ("web/templates/boards/entry.html", "Compare with another entry"),
        ("api/deps.py", "this needs the scope {…}; yours are {…}"),
        ("api/errors.py", "Not found, or no access."),
        ("stone_client/commands/benchmark/teams.py", "Create a team; you are its captain."),
        ("web/modules/submission/verdict.ts", "This cannot be read as a submission."),
        ("docs/glossary.md", "# Glossary"),
    ):
        assert (path, text) in texts, (path, text)


def test_each_term_of_the_glossary_is_used_elsewhere(shown: tuple[ShownString, ...]) -> None:
    elsewhere = " ".join(one.text for one in shown if one.path != "docs/glossary.md").lower()
    rows = re.findall(r"^\| (?!term|-)([^|]+) \|", GLOSSARY.read_text("utf-8"), re.MULTILINE)
    terms = [term for row in rows for term in re.split(r", | or ", re.sub(r"\([^)]*\)|[`*]", "", row).strip())]
    assert len(terms) > 50
    assert [term for term in terms if term.strip().lower() not in elsewhere] == []
