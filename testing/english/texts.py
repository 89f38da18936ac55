"""Texts of a checkout: Markdown pages, page templates, TypeScript, and docstrings, comments and strings of Python.

**Conventions.** A text has at least four words, except docstrings. Code blocks, SQL, patterns and keys are not texts.
Tests are not read: their sentences reach no user.
"""

import ast
import inspect
import io
import re
import subprocess
import tokenize
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from testing.english.pages import LEAST_WORDS, markdown_texts, template_texts, typescript_texts

ROOT = Path(__file__).resolve().parents[2]
OTHERS = ("tests/", "web/libraries/", "testing/english/")
"""Folders that are not read: tests, libraries by others, and this check, which quotes what it finds."""
NO_PROSE = re.compile(
    r"\b(?:SELECT|INSERT|CREATE TABLE|UPDATE|DELETE FROM|PRAGMA)\b|\bpython -c|\(\?[P:!=<]|\\[dwsb(]|=>|&&"
    r"|[{}<>]\S*[{}<>]\S*[{}<>]|^\s*[-.#$]"
)
DIRECTIVE = re.compile(r"#\s*(?:type:|noqa|fmt:|pragma|!|ruff|mypy)")
PROPERTIES = {"property", "cached_property", "setter", "fixture", "overload"}


class Source(Enum):
    """Kinds of texts."""

    DOCS = "docs"
    HEADING = "heading"
    CELL = "table cell"
    PAGE = "page text"
    SCRIPT = "TypeScript"
    DOCSTRING = "docstring"
    FUNCTION = "function's docstring"
    COMMENT = "comment"
    STRING = "string"
    NAME = "name of a variable"


class Text(NamedTuple):
    """One paragraph, cell, docstring paragraph, comment or string, and the line on which it starts."""

    path: str
    line: int
    source: Source
    words: str


def tracked(root: Path = ROOT) -> list[str]:
    """Return the paths of all tracked files that are read."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=root, check=True, capture_output=True).stdout.decode()
    suffixes = (".py", ".md", ".html", ".ts")
    return [path for path in listing.split("\0") if path.endswith(suffixes) and not path.startswith(OTHERS)]


def texts_of(path: str, root: Path = ROOT) -> Iterator[Text]:
    """Yield the texts of one file."""
    content = (root / path).read_text("utf-8")
    if path.endswith(".py"):
        yield from _python_texts(path, content)
    elif path.endswith(".md"):
        for line, kind, words in markdown_texts(content):
            yield Text(path, line, Source(kind), words)
    else:
        source = Source.PAGE if path.endswith(".html") else Source.SCRIPT
        texts = template_texts(content) if source is Source.PAGE else typescript_texts(content)
        for line, words in texts:
            yield Text(path, line, source, words)


def _python_texts(path: str, content: str) -> Iterator[Text]:
    tree = ast.parse(content)
    docstrings = dict(_docstrings(tree))
    for node, source in docstrings.items():
        for offset, paragraph in _paragraphs(inspect.cleandoc(str(node.value))):
            yield Text(path, node.lineno + offset, source if offset == 0 else Source.DOCS, paragraph)
    yield from (Text(path, line, Source.COMMENT, words) for line, words in _comments(content))
    inside = {part for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    fields = {part for node in ast.walk(tree) if isinstance(node, ast.ClassDef) for part in _targets(node)}
    for part in ast.walk(tree):
        if isinstance(part, ast.JoinedStr | ast.Constant) and part not in inside and part not in docstrings:
            paragraphs = re.split(r"\n\s*\n|\n#+ |\n[-*] |(?:\n {4}.*)+|\n\|.*", _spelled(part))
            yield from (Text(path, part.lineno, Source.STRING, words) for words in paragraphs if is_prose(words))
        elif isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store) and part not in fields:
            yield Text(path, part.lineno, Source.NAME, part.id)


def _docstrings(tree: ast.Module) -> Iterator[tuple[ast.Constant, Source]]:
    """Yield the docstrings, also of constants and fields."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for index, statement in enumerate(body if isinstance(body, list) else ()):
            value = statement.value if isinstance(statement, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and index == 0
                yield value, Source.FUNCTION if is_function and not _is_property(node) else Source.DOCSTRING


def _targets(node: ast.ClassDef) -> Iterator[ast.expr]:
    """Yield the names of a class's own fields, which may be keys of a record or of the API."""
    for statement in node.body:
        if isinstance(statement, ast.AnnAssign):
            yield statement.target
        elif isinstance(statement, ast.Assign):
            yield from statement.targets


def _is_property(node: ast.AST) -> bool:
    decorators = getattr(node, "decorator_list", ())
    return any(PROPERTIES & set(re.findall(r"\w+", ast.unparse(decorator))) for decorator in decorators)


def _paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """Yield the paragraphs and list items of a docstring, each with the line on which it starts."""
    start, lines = 0, list[str]()
    for number, line in enumerate([*text.split("\n"), ""]):
        if lines and (not line.strip() or re.match(r"\s*(?:[-*|]|\d+\.) ", line)):
            yield start, " ".join(lines)
            lines = []
        if line.strip() and not line.lstrip().startswith((">>>", "|")) and not line.startswith("    "):
            start, lines = start if lines else number, [*lines, re.sub(r"^\s*[-*] ", "", line).strip()]


def _comments(content: str) -> Iterator[tuple[int, str]]:
    """Yield each comment; neighbouring lines are one."""
    start, last, words = 0, -1, ""
    for token in tokenize.generate_tokens(io.StringIO(content).readline):
        if token.type != tokenize.COMMENT or DIRECTIVE.match(token.string):
            continue
        alone = token.line.lstrip().startswith("#")
        if words and not (alone and token.start[0] == last + 1):
            yield start, words
            words = ""
        start, words = start if words else token.start[0], f"{words} {token.string.lstrip('#!').strip()}".strip()
        last = token.start[0] if alone else -1
    if words:
        yield start, words


def _spelled(node: ast.JoinedStr | ast.Constant) -> str:
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    parts = (part.value if isinstance(part, ast.Constant) else "`x`" for part in node.values)
    return "".join(str(part) for part in parts)


def is_prose(words: str) -> bool:
    """Return whether a string is a sentence for people and no query, pattern or path."""
    spelled = re.findall(r"(?<![\w/.-])[A-Za-z][a-z]+(?![\w/])", words)
    return len(spelled) >= LEAST_WORDS and not NO_PROSE.search(words) and 2 * len(spelled) >= len(words.split())
