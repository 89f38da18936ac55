"""Every path and every module that a docstring, a comment or a page names is there.

**Conventions.** A path begins with one of the checkout's folders, as `stone/geometry/se3.py` does, or with a folder
beside the file that names it. A module is a dotted name below one of our packages, followed or not by a name that it
defines. Names with `<`, `*` or `…` stand for many, and files that git ignores are made by a build: neither is checked.
Bare words in backticks are not checked, since nothing tells a module from an option: write the path of a module.

Catches alone a reader who is sent to a file that was moved.
"""

import ast
import io
import re
import subprocess
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path, PurePosixPath

import pytest

pytestmark = pytest.mark.whole

ROOT = Path(__file__).resolve().parents[1]
OF_OPERATORS = ("deploy/compose/secrets/",)  # made by whoever deploys
PAGES = {"Makefile", ".ci/run", "pyproject.toml", "mkdocs.yml"}


@cache
def tracked() -> frozenset[str]:
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout, so nothing says which files are the project's")
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True).stdout
    return frozenset(name for name in listing.decode().split("\0") if name)


@cache
def folders() -> frozenset[str]:
    return frozenset(str(folder) for name in tracked() for folder in PurePosixPath(name).parents if folder.name)


@cache
def path_pattern() -> re.Pattern[str]:
    tops = "|".join(sorted((name for name in folders() if "/" not in name and name[0] != "."), key=len, reverse=True))
    kubernetes = r"(?!deploy/stone-)"  # as kubectl names a deployment
    return re.compile(rf"(?<![\w/.<>{{}}$-]){kubernetes}((?:{tops})/[\w./-]*\w)(?![\w/*<{{…-])")


@cache
def module_pattern() -> re.Pattern[str]:
    """Names of two parts count if their root is no word of other uses, such as settings (`api.url`)."""
    roots = {name.partition("/")[0] for name in tracked() if name.endswith("/__init__.py")}
    plain = "|".join(sorted(roots))
    telling = "|".join(sorted(root for root in roots if "_" in root or root == "services"))
    return re.compile(
        rf"(?<![\w/.@:-])(?!stone\.example\b)((?:{plain})(?:\.[A-Za-z]\w*){{2,}}|(?:{telling})\.[A-Za-z]\w*)(?![\w/(-])"
    )


def comments_and_docstrings(source: str) -> Iterator[tuple[int, str]]:
    """Each with its line; a string that stands alone documents what is above it."""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


def texts_of(name: str) -> Iterator[tuple[int, str]]:
    if name.endswith(".py"):
        yield from comments_and_docstrings((ROOT / name).read_text("utf-8"))
    elif name.endswith(".md") or name in PAGES:
        yield from enumerate((ROOT / name).read_text("utf-8").splitlines(), 1)


def is_path(path: str, named_by: str) -> bool:
    beside = str(PurePosixPath(named_by).parent / path)
    return any(place in tracked() or place in folders() for place in (path.rstrip("/"), beside))


@cache
def names_of_module(path: str) -> frozenset[str]:
    """Every name that a module binds anywhere in it, imports and attributes included."""
    tree = list(ast.walk(ast.parse((ROOT / path).read_text("utf-8"))))
    defined = {node.name for node in tree if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)}
    assigned = {node.id for node in tree if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    imported = {alias.asname or alias.name for node in tree if isinstance(node, ast.ImportFrom) for alias in node.names}
    return frozenset(defined | assigned | imported)


def is_module_or_name(dotted: str) -> bool:
    parts = dotted.split(".")
    for length in range(len(parts), 0, -1):
        place = "/".join(parts[:length])
        if module := next((path for path in (f"{place}.py", f"{place}/__init__.py") if path in tracked()), None):
            return length == len(parts) or set(parts[length:]) <= names_of_module(module)
    return False


def dead_names(name: str, text: str) -> Iterator[str]:
    yield from (path for path in path_pattern().findall(text) if not is_path(path, name))
    yield from (module for module in module_pattern().findall(text) if not is_module_or_name(module))


def is_made(path: str) -> bool:
    """Whether it lies in a folder that git ignores, or that an operator makes."""
    lines = (ROOT / ".gitignore").read_text("utf-8").splitlines()
    return f"{path}/".startswith((*OF_OPERATORS, *(line[1:] for line in lines if line.startswith("/"))))


def test_every_path_and_module_that_is_named_is_there() -> None:
    dead = {
        (name, line, word)
        for name in tracked()
        if (ROOT / name).is_file()
        for line, text in texts_of(name)
        for word in dead_names(name, text)
    }
    assert sorted(f"{name}:{line}: {word}" for name, line, word in dead if not is_made(word)) == []


@pytest.mark.parametrize(
    ("text", "dead"),
    [
        ("see `stone/geometry/se3.py` and stone/geometry/", []),
        ("see `stone/geometry/se4.py`.", ["stone/geometry/se4.py"]),
        ("read (services/runtime/jobs/claiming.py)", ["services/runtime/jobs/claiming.py"]),
        ("`stone.geometry.se3.slerp`, services.runtime.jobs.claims", []),
        ("a quaternion, as stone.geometry.se3.slurp says", ["stone.geometry.se3.slurp"]),
        ("(see `services.labeler.poisson`)", ["services.labeler.poisson"]),
        ("`services.other`", ["services.other"]),
        ("baselines/models/<row>.py, tests/*.py, https://stone.example.org/api/v1", []),
    ],
)
def test_a_dead_name_is_noticed_and_a_living_one_is_not(text: str, dead: list[str]) -> None:
    assert list(dead_names("README.md", text)) == dead


def test_names_are_looked_for_in_docstrings_and_comments() -> None:
    source = '"""Head."""\nx = 1  # reason\n"""About x."""\ndef f():\n    """Of f."""\n    return "no"\n'
    assert sorted(comments_and_docstrings(source)) == [
        (1, "Head."), (2, "# reason"), (3, "About x."), (5, "Of f.")
    ]  # fmt: skip
