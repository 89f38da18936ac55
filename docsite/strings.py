"""Every string that a page, an answer, a command or the docs can show: `python -m docsite.strings` lists them.

**Conventions.** The sources are parsed, not run. The list contains the text of templates, lines of the docs, and
literals of Python and TypeScript that contain a blank. It also contains docstrings shown to users (titles of errors,
summaries of routes, help of commands), and literals that only logs show.
"""

import ast
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

from jinja2 import Environment

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = (
    "api", "web", "services", "stone", "stone_base", "stone_client", "stone_datasets", "stone_exports", "stone_files",
    "stone_local", "stone_recordings", "stone_submissions", "simulator", "baselines",
)  # fmt: skip
# Folders whose functions' docstrings are shown: as the summary of a route, or as the help of a command.
SHOWN_DOCSTRINGS = ("api/routes/", "stone_client/commands/", "stone_local/commands/")
SHOWN_ATTRIBUTES = ("title", "alt", "aria-label", "placeholder", "content")
BLANKS = re.compile(r"\s+")
TYPESCRIPT = re.compile(
    r"""//[^\n]*|/\*.*?\*/|"((?:\\.|[^"\\\n])*)"|'((?:\\.|[^'\\\n])*)'|`((?:\\.|[^`\\])*)`""", re.DOTALL
)


@dataclass(frozen=True)
class ShownString:
    """A string and its location: a path from the project's root, and a line."""

    path: str
    line: int
    text: str


def shown_strings() -> Iterator[ShownString]:
    """Yield all strings in order of location, each location once."""
    for folder, ending, strings in (
        *((program, ".py", _of_python) for program in PROGRAMS),
        ("web/templates", ".html", _of_template),
        ("services", ".html", _of_template),
        ("stone_recordings", ".html", _of_template),
        ("web/modules", ".ts", _of_typescript),
        ("docs", ".md", _of_page),
    ):
        for path in sorted((ROOT / folder).rglob(f"*{ending}")):
            if "node_modules" not in path.parts:
                yield from _of_file(path, strings)
    yield from _of_file(ROOT / "README.md", _of_page)


def _of_file(path: Path, strings: Callable[[str, str], Iterator[tuple[int, str]]]) -> Iterator[ShownString]:
    path_text = path.relative_to(ROOT).as_posix()
    for line, raw in sorted(set(strings(path_text, path.read_text("utf-8")))):
        text = BLANKS.sub(" ", raw).strip()
        if re.search(r"[A-Za-z]{2}", text):
            yield ShownString(path_text, line, text)


def _of_template(_: str, source: str) -> Iterator[tuple[int, str]]:
    parts = []
    is_variable = False
    for line, kind, value in Environment().lex(source):
        if kind == "string" and (" " in value or value[1:2].isupper()):
            yield line, value.strip("\"'")
        if kind == "data":
            parts.append(value)
        elif kind == "variable_begin":
            parts.append("{…}")
            is_variable = True
        elif not is_variable:
            parts.append(value.count("\n") * "\n" or (" " if kind == "block_end" else ""))
        is_variable = is_variable and kind != "variable_end"
    page = _Texts()
    page.feed("".join(parts))
    page.close()
    yield from page.texts


class _Texts(HTMLParser):
    """The texts between tags, and the attributes that are shown or read aloud."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[tuple[int, str]] = []

    def handle_data(self, data: str) -> None:
        self.texts.append((self.getpos()[0], data))

    def handle_starttag(self, _: str, attrs: list[tuple[str, str | None]]) -> None:
        self.texts.extend((self.getpos()[0], value or "") for name, value in attrs if name in SHOWN_ATTRIBUTES)


def _of_python(place: str, source: str) -> Iterator[tuple[int, str]]:
    tree = ast.parse(source)
    held = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            docstring = ast.get_docstring(node, clean=True)
            held.add(id(getattr(node.body[0], "value", None)) if docstring and node.body else 0)
            if docstring and _is_shown(place, node):
                yield node.body[0].lineno, docstring.split("\n\n")[0]
        elif isinstance(node, ast.JoinedStr):
            yield node.lineno, "".join(_part(value) for value in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value.strip():
            yield from [] if id(node) in held else [(node.lineno, node.value)]


def _is_shown(place: str, node: ast.AST) -> bool:
    if isinstance(node, ast.ClassDef):
        return any(ast.unparse(base).endswith("Error") for base in node.bases)
    return isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and place.startswith(SHOWN_DOCSTRINGS)


def _part(value: ast.expr) -> str:
    return str(value.value) if isinstance(value, ast.Constant) else "{…}"


def _of_typescript(_: str, source: str) -> Iterator[tuple[int, str]]:
    for match in TYPESCRIPT.finditer(source):
        text = next((group for group in match.groups() if group), "")
        if " " in text.strip() or text[:1].isupper():
            yield source.count("\n", 0, match.start()) + 1, text


def _of_page(_: str, source: str) -> Iterator[tuple[int, str]]:
    yield from enumerate(source.splitlines(), 1)


def main() -> None:
    """Print location, a tab and the string."""
    for shown in shown_strings():
        sys.stdout.write(f"{shown.path}:{shown.line}\t{shown.text}\n")


if __name__ == "__main__":
    main()
