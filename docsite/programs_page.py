"""The reference of benchmark, chaos and fuzz programs, from their docstrings."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from docsite.markdown import code

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = {"benchmarks": "Measure", "chaos": "Fault injection", "fuzz": "Fuzz"}
USED_AS = re.compile(r"(?m)`((?:\.venv/bin/)?python (?:-m )?[^`]+)`|^ {4}(\.venv/bin/python -m .+)$")
HEAD = """# Programs

Benchmarks, chaos tests and fuzzers: the commands behind every figure of this site. Run them in the repository's root
with `.venv/bin/` before them. Each text is the program's own docstring.
"""


def programs_page() -> str:
    """Return the page."""
    parts = [HEAD]
    for folder, title in FOLDERS.items():
        parts.append(f"## {title}\n")
        parts += [_in_words(*program) for program in programs(folder)]
    return "\n".join(parts)


def programs(folder: str) -> Iterator[tuple[str, str]]:
    """Yield module and docstring of every program in the folder whose docstring contains its command line."""
    for path in sorted((ROOT / folder).rglob("*.py")):
        source = path.read_text("utf-8")
        words = ast.get_docstring(ast.parse(source)) or ""
        if USED_AS.search(words) and '__name__ == "__main__"' in source:
            parts = path.relative_to(ROOT).with_suffix("").parts
            yield ".".join(part for part in parts if part != "__main__"), words


def _in_words(module: str, words: str) -> str:
    used = USED_AS.search(words)
    line = (used.group(1) or used.group(2)) if used else f"python -m {module}"
    paragraphs = re.split(r"\n\s*\n", USED_AS.sub("", words, count=1))
    prose = [" ".join(paragraph.split()) for paragraph in paragraphs if "**Conventions.**" not in paragraph]
    first = prose[0].replace(": .", ".").replace(" .", ".").rstrip(": ")
    prose_text = "\n\n".join([first, *prose[1:]])
    return f"### {code(module)}\n\n```\n{line}\n```\n\n{prose_text}\n"
