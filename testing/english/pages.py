"""Texts of Markdown pages, page templates and TypeScript modules, each with its line."""

import re
from collections.abc import Iterator

FENCE = re.compile(r"^\s*(```|~~~)")
ITEM = re.compile(r"^\s*(?:[-*+]|\d+\.)\s+")
INLINE = {"a", "abbr", "b", "bdi", "em", "i", "mark", "q", "s", "small", "span", "strong", "sub", "sup", "time"}
CODE_TAGS = {"code", "kbd"}
MARKUP = re.compile(r"</?(?P<tag>[a-zA-Z][\w-]*)(?P<attributes>[^<>]*)>|(?P<words>[^<]+|<)")
SILENT = re.compile(r"<(script|style|pre)\b.*?</\1>|<!--.*?-->", re.DOTALL)
SPOKEN = re.compile(r"\b(?:title|aria-label|alt|placeholder)=\"([^\"]*)\"")
"""Attributes that people read, or hear from a screen reader."""
LEAST_WORDS = 4
STATEMENT = re.compile(r"\{%.*?%\}|\{#.*?#\}", re.DOTALL)
EXPRESSION = re.compile(r"\{\{.*?\}\}", re.DOTALL)
SCRIPT_TEXT = re.compile(
    r"/\*(?P<block>.*?)\*/|(?<![:\w])//(?P<line>[^\n]*)"
    r"|\"(?P<double>(?:[^\"\\\n]|\\.)*)\"|'(?P<single>(?:[^'\\\n]|\\.)*)'|`(?P<template>(?:[^`\\]|\\.)*)`",
    re.DOTALL,
)
WORDS = re.compile(r"(?<![\w/.#-])[A-Za-z][a-z]+(?![\w/=(-])")


def markdown_texts(content: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, kind ("docs", "heading", "table cell") and words of each paragraph, list item and fact of a cell.

    Semicolons separate the facts of a cell.
    """
    is_code, is_list, start, lines = False, False, 0, list[str]()
    for number, line in enumerate([*content.split("\n"), ""], 1):
        is_fence = FENCE.match(line) is not None
        bare = line.strip()
        is_alone = is_fence or is_code or not bare or bare.startswith(("|", "#", ">", "<!--", "!!!", "---"))
        if lines and (is_alone or ITEM.match(line)):
            yield start, "docs", " ".join(lines)
            lines = []
        is_code = is_code != is_fence
        is_list = ITEM.match(line) is not None or (is_list and (not bare or line.startswith(" ")))
        if is_fence or is_code or (line.startswith("    ") and not is_list):
            continue
        if bare.startswith("|"):
            if not re.fullmatch(r"[|:\s-]+", bare):
                cells = re.split(r"(?<!\\)\|", re.sub(r"`[^`]*`", "`x`", bare).strip("|"))
                facts = (fact.strip() for cell in cells for fact in cell.split("; "))
                yield from ((number, "table cell", fact) for fact in facts if fact)
        elif bare.startswith("#"):
            yield number, "heading", bare.lstrip("# ")
        elif bare and not bare.startswith(("<!--", "---")):
            start = start if lines else number
            lines.append(ITEM.sub("", line).strip().lstrip("> "))


def template_texts(content: str) -> Iterator[tuple[int, str]]:
    """Yield line and words of each text of a Jinja template; an expression counts as one word."""
    page = STATEMENT.sub(lambda match: "\n" * match[0].count("\n"), content)
    page = SILENT.sub(lambda match: "<p>" + "\n" * match[0].count("\n"), page)
    page = EXPRESSION.sub(lambda match: "`x`" + "\n" * match[0].count("\n"), page)
    start, words = 1, ""
    for match in MARKUP.finditer(f"{page}<p>"):
        line = page.count("\n", 0, match.start()) + 1
        tag = match["tag"]
        if tag is None:
            blank = len(match["words"]) - len(match["words"].lstrip())
            start = start if words.strip() else line + match["words"].count("\n", 0, blank)
            words += match["words"]
        elif tag in CODE_TAGS:
            words += "`"
        elif tag not in INLINE:
            if _is_text(words):
                yield start, " ".join(words.split())
            words = ""
        spoken = SPOKEN.findall(match["attributes"] or "")
        yield from ((line, value) for value in spoken if _is_text(value))


def typescript_texts(content: str) -> Iterator[tuple[int, str]]:
    """Yield line and words of each comment and each string of a TypeScript module."""
    line, at, comment, start, last = 1, 0, list[str](), 0, -1
    for match in SCRIPT_TEXT.finditer(content):
        line, at = line + content.count("\n", at, match.start()), match.start()
        if match["line"] is not None:
            if comment and last != line - 1:
                yield start, " ".join(comment)
                comment = []
            start, last = start if comment else line, line
            comment.append(match["line"].strip())
        elif match["block"] is not None:
            paragraph = " ".join(re.sub(r"^\s*\*+ ?", "", part) for part in match["block"].split("\n"))
            if _is_text(paragraph):
                yield line, paragraph.strip("* ")
        else:
            words = re.sub(r"\$\{[^}]*\}", "`x`", match["double"] or match["single"] or match["template"] or "")
            if _is_text(words) and not re.search(r"[{}<>]\s*\n|void main|;\n", words):
                yield line, words
    if comment:
        yield start, " ".join(comment)


def _is_text(words: str) -> bool:
    return len(WORDS.findall(words)) >= LEAST_WORDS
