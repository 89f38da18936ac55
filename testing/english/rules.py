"""The rules of docs/style.md that a machine can apply, each by its name.

**Conventions.** A rule takes one sentence and returns whether the sentence breaks it. A rule finds less than a reader
would: a sentence without a hit is not yet a good one.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from testing.english.sentences import sentences, word_count
from testing.english.texts import Source, Text

MOST_WORDS = 30
LONGEST_LABEL = 5
START = r"(?:^|[;:] )[\"'(“]*"


class Hit(NamedTuple):
    """A sentence that breaks a rule."""

    rule: str
    text: Text
    sentence: str

    def __str__(self) -> str:
        return f"{self.text.path}:{self.text.line}: {self.rule}: {self.sentence}"


def _finds(pattern: str, flags: re.RegexFlag = re.IGNORECASE) -> Callable[[str], bool]:
    compiled = re.compile(pattern, flags)
    return lambda sentence: compiled.search(sentence) is not None


def _is_clause_as_subject(sentence: str) -> bool:
    """Return whether a clause ("What is unobserved", "Whoever signs in") stands for the actor; questions are none."""
    is_question = sentence.rstrip("\"')”").endswith("?")
    return not is_question and (CLAUSE.search(sentence) or GENITIVE.match(sentence)) is not None


CLAUSE = re.compile(rf"{START}(?:What|Who|Whoever|Whatever|Whichever)\b(?! to\b)", re.IGNORECASE)
GENITIVE = re.compile(r"[\"'(“]*Of (?!course\b)\w+")
ANYWHERE: Mapping[str, Callable[[str], bool]] = {
    "long": lambda sentence: word_count(sentence) > MOST_WORDS,
    "clause as subject": _is_clause_as_subject,
    "of which": _finds(r"\bof (?:which|whom)\b"),
    "program that speaks": _finds(
        r"\b(?:says|said|tells?|told|asks|asked|hears?|heard|believes?|believed|knows)\b(?! Protocol)"
    ),
    "by itself": _finds(r"\bby (?:itself|themselves|oneself|himself)\b"),
    "begun": _finds(r"\b(?:begun|(?:goes?|going|went|gone) on|(?:gives?|given|gave) back)\b"),
    "nobody": _finds(r"\b(?:nobody|somebody|whoever|everybody)\b"),
    "where for if": _finds(
        r"\bwhere (?:(?:there|they|it|one) (?:is|are|was|were|has|have|does|can)\b|none\b|nothing\b|no\b)"
        r"|\b(?:None|NaN|nothing|zero|empty|else|0|−1) where\b|^Where\b(?!.*\?$)"
    ),
}
"""Rules for every sentence."""
OF_PROSE = {"clause as subject", "where for if"}
"""Rules that do not hold for titles."""
FIRST: Mapping[str, Callable[[str], bool]] = {
    "docstring begins with a clause": _finds(r"^(?:Of|What|Where|Who|How|Those|That|So)\b", re.NOFLAG),
}
"""Rules for the first sentence of a docstring."""
OF_FUNCTIONS: Mapping[str, Callable[[str], bool]] = {
    "function without a verb": _finds(
        r"^(?:The|A|An|Each|Every|All|Per|Its|Their|Both|Any|Some|No|None|Row|Rows|Names?|Number|True|False|One|Two)\b",
        re.NOFLAG,
    ),
}
"""Rules for the first sentence of a function's docstring."""
FRAGMENT = re.compile(
    r"(?:of|what(?! to\b)|where|who|those|which|else|so|such|than|the same as)\b(?!.*\?$)", re.IGNORECASE
)
OF_CELLS: Mapping[str, Callable[[str], bool]] = {
    "cell without a subject": lambda cell: FRAGMENT.match(cell) is not None and word_count(cell) > 2,
}
"""Rules for table cells and for the help of options."""
OF_NAMES: Mapping[str, Callable[[str], bool]] = {
    "name without a noun": lambda name: name in {"found", "one", "told", "said", "asked", "place"},
}
"""Rules for the names of variables."""
RULES = (*ANYWHERE, *FIRST, *OF_FUNCTIONS, *OF_CELLS, *OF_NAMES)


def hits(text: Text) -> Iterator[Hit]:
    """Yield each sentence of a text that breaks a rule, once per rule."""
    if text.source is Source.NAME:
        yield from (Hit(rule, text, text.words) for rule, breaks in OF_NAMES.items() if breaks(text.words))
        return
    for index, sentence in enumerate(sentences(text.words)):
        rules = {**ANYWHERE, **(_of_first(text.source) if index == 0 else {})}
        for rule, breaks in rules.items():
            if breaks(sentence) and not (rule in OF_PROSE and _is_title(text.source, sentence)):
                yield Hit(rule, text, sentence)


def _is_title(source: Source, sentence: str) -> bool:
    """Return whether a sentence is a heading or a short label, which may be a clause ("What the codes mean")."""
    is_label = source in {Source.STRING, Source.PAGE, Source.CELL} and word_count(sentence) <= LONGEST_LABEL
    return source is Source.HEADING or (is_label and not sentence.endswith("."))


def _of_first(source: Source) -> Mapping[str, Callable[[str], bool]]:
    """Return the rules for the first sentence of a text alone."""
    match source:
        case Source.FUNCTION:
            return {**FIRST, **OF_FUNCTIONS}
        case Source.DOCSTRING:
            return FIRST
        case Source.CELL:
            return OF_CELLS
        case _:
            return {}
