"""Sentences of a text: markup is removed, code counts as one word.

**Conventions.** A text is one paragraph, list item, table cell, docstring paragraph or string. Code spans and
placeholders become the word `code`, and a list of them counts once.
"""

import re

ABBREVIATIONS = re.compile(
    r"\b(e\.g|i\.e|et al|Fig|Eq|Eqs|vs|cf|ca|No|approx|resp|etc|Sec|Tab|St|Dr|incl|excl|min|max)\."
)
SPLIT = re.compile(r"(?<=[.!?])[\"')\]”’*]*\s+(?=[\"'(\[“‘*]*(?:[A-Z0-9`—–]|code\b))")
CODE = re.compile(r"``.+?``|`[^`]*`", re.DOTALL)
LINK = re.compile(r"!?\[([^\]]*)\](?:\([^)]*\)|\[[^\]]*\])")
TAG = re.compile(r"<[^<>\n]{1,300}>")
CODE_LIST = re.compile(r"\bcode\b(?:\s*(?:,|/|and|or|, and|, or|→|×|\|)\s*\bcode\b)+")
WORD = re.compile(r"[^\W_][\w'’.\-]*")


def plain(text: str) -> str:
    """Return the text without markup: links become their words, code becomes `code`."""
    text = CODE.sub("code", text)
    text = LINK.sub(r"\1", text)
    text = TAG.sub("", text).replace("**", "").replace("&nbsp;", " ")
    text = re.sub(r"https?://\S+", "code", text)
    text = CODE_LIST.sub("code", text)
    return " ".join(text.split())


def sentences(text: str) -> list[str]:
    """Return the sentences of a text, without markup."""
    guarded = ABBREVIATIONS.sub(lambda match: match[0][:-1] + "․", plain(text))
    return [part.replace("․", ".").strip() for part in SPLIT.split(guarded) if WORD.search(part)]


def word_count(sentence: str) -> int:
    """Return the number of words of a sentence."""
    return len(WORD.findall(sentence))
