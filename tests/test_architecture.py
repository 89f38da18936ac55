"""The platform keeps its shape: the arrow of dependency, small files, plain words, nothing of one machine in it."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import pytest

from stone_client.command_tree import COMMANDS
from stone_client.lazy_commands import GroupPlace, Place
from stone_client.old_words import words_of_today

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    "stone", "stone_base", "stone_files", "stone_recordings", "stone_submissions", "stone_exports", "stone_datasets",
    "baselines", "services", "simulator", "stone_client", "stone_local", "api", "web",
)  # fmt: skip
SOURCES = tuple(
    path
    for package in (*PACKAGES, "chaos", "fuzz", "testing")
    for path in sorted((ROOT / package).rglob("*.py"))
    if "node_modules" not in path.parts
)
MAX_FILE_LINES = 500
MAX_FUNCTION_LINES = 50
EMPTY_WORDS = {"util", "utils", "helper", "helpers", "manager", "common", "misc"}
EMPTY_VERBS = ("get_", "do_", "handle_")
# As http.server calls them, and as click and typer do.
NAMED_BY_A_LIBRARY = {"do_GET", "do_POST", "get_params", "_get_default_string", "_get_number_range_help_str"}
# llvmlite is the half of numba that emits instructions; an intrinsic (popcount) needs its types.
STONE_MAY_IMPORT = {"stone", "stone_base", "numpy", "scipy", "numba", "llvmlite"} | {
    "dataclasses", "typing", "enum", "math", "hashlib", "collections", "functools", "itertools", "abc", "re",
}  # fmt: skip
# Character classes keep each pattern from finding itself.
OF_ONE_MACHINE = re.compile(
    r"[/]work/|[/]tmp/lab|[/]root/|[/]home/[a-z]|[/]opt/[a-z]|farm[-][a-z]+|[:]//[^\s/]+/simple\b|index[-]url"
)


def tracked_files() -> tuple[Path, ...]:
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout, so nothing says which files are the project's")
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True).stdout
    return tuple(ROOT / name for name in listing.decode().split("\0") if name and (ROOT / name).is_file())


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache", "--no-logo"]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    return subprocess.run(command, cwd=folder, env=environment, check=False, capture_output=True, text=True)


@lru_cache(maxsize=1)
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    """The module, then all that is in it."""
    return tuple(ast.walk(ast.parse(path.read_text("utf-8"))))


def functions_of(path: Path) -> Iterator[ast.FunctionDef]:
    yield from (node for node in nodes_of(path) if isinstance(node, ast.FunctionDef))


def roots_imported_by(path: Path) -> set[str]:
    """The packages, ours and others', that the module imports anywhere in it."""
    imported: set[str] = set()
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add((node.module or ".").split(".")[0])
    return imported


def names_defined_in(path: Path) -> Iterator[str]:
    """The module, its folder, its classes, functions and assigned names."""
    yield from (path.stem, path.parent.name)
    for node in nodes_of(path):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


def noun_of(name: str) -> str:
    """The last word of a snake_case or CamelCase name, which says what it is."""
    return next(reversed(re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)), "").lower()


def statement_lines(function: ast.FunctionDef) -> int:
    """Lines of the function without its decorators and its docstring."""
    body = function.body[1:] if ast.get_docstring(function) else function.body
    return (function.end_lineno or 0) - body[0].lineno + 1 if body else 0


def is_kernel(function: ast.FunctionDef) -> bool:
    return any("njit" in ast.unparse(decorator) for decorator in function.decorator_list)


def test_the_import_contracts_are_kept() -> None:
    outcome = lint_imports(ROOT)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr


@pytest.mark.whole
@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("stone/errors.py", "import pathlib"),
        ("stone/errors.py", "import services.runtime"),
        ("services/__init__.py", "import stone_client.main"),
        ("services/eval/__init__.py", "import services.ingest"),
        ("services/runtime/__init__.py", "import services.domain"),
        ("stone_recordings/__init__.py", "import services.runtime"),
        ("stone_client/main.py", "import open3d"),
        ("stone_client/main.py", "import stone_local.registry"),
        ("stone_client/devkit/frame.py", "import stone.labels.grid"),
        ("stone_client/devkit/frame.py", "import torch"),
        ("stone_submissions/archive.py", "import stone.scoring"),
    ],
)
def test_a_broken_import_contract_is_noticed(tmp_path: Path, module: str, line: str) -> None:
    for package in PACKAGES:
        shutil.copytree(
            ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__", "node_modules")
        )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    with (tmp_path / module).open("a") as source:
        source.write(f"\n{line}\n")
    outcome = lint_imports(tmp_path)
    assert outcome.returncode == 1, outcome.stdout + outcome.stderr
    assert "BROKEN" in outcome.stdout


def test_stone_imports_numbers_and_plain_values_only() -> None:
    papers = [path for path in SOURCES if path.is_relative_to(ROOT / "stone")]
    found = {said(path): roots_imported_by(path) - STONE_MAY_IMPORT for path in papers}
    assert {path: roots for path, roots in found.items() if roots} == {}


@pytest.mark.whole
def test_nothing_outside_of_the_tests_imports_them_and_what_ships_imports_nothing_that_is_for_trying_it() -> None:
    of_trials = {"testing", "chaos", "benchmarks", "fuzz", "docsite"}
    found = []
    for path in tracked_files():
        if path.suffix == ".py" and path.relative_to(ROOT).parts[0] != "tests":
            barred = {"tests"} | (of_trials if path.relative_to(ROOT).parts[0] in PACKAGES else set())
            found += [f"{path.relative_to(ROOT)} imports {name}" for name in sorted(roots_imported_by(path) & barred)]
    assert found == []


@pytest.mark.whole
def test_source_files_are_small_and_plainly_named() -> None:
    assert [f"{said(path)}: {fault}" for path in SOURCES for fault in faults_of(path)] == []


def test_a_file_that_is_neither_small_nor_plainly_named_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "tile_utils.py"
    long = "".join(f"    a{number} = {number}\n" for number in range(MAX_FUNCTION_LINES + 1))
    path.write_text(f"x = 1  # TODO\n\n\ndef get_tile():\n{long}" + "\n" * MAX_FILE_LINES)
    told = " ".join(faults_of(path))
    for fault in ("lines", "tile_utils says nothing", "get_tile has an empty verb", "get_tile is too long", "TODO"):
        assert fault in told
    assert "docstring" in told


def faults_of(path: Path) -> Iterator[str]:
    source = path.read_text("utf-8")
    if len(source.splitlines()) > MAX_FILE_LINES:
        yield f"more than {MAX_FILE_LINES} lines"
    for name in names_defined_in(path):
        if noun_of(name) in EMPTY_WORDS:
            yield f"{name} says nothing"
        if name.lstrip("_").startswith(EMPTY_VERBS) and name not in NAMED_BY_A_LIBRARY:
            yield f"{name} has an empty verb"
    for function in functions_of(path):
        if not is_kernel(function) and statement_lines(function) > MAX_FUNCTION_LINES:
            yield f"{function.name} is too long"
    if "# TODO" in source:
        yield "a TODO"
    module = nodes_of(path)[0]
    if source and isinstance(module, ast.Module) and not ast.get_docstring(module):
        yield "a module begins with a docstring"


def said(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_no_tracked_file_names_a_place_of_one_machine() -> None:
    found = []
    for path in tracked_files():
        content = path.read_bytes()
        if b"\0" in content[:8192]:
            continue
        for number, line in enumerate(content.decode("utf-8").splitlines(), 1):
            if OF_ONE_MACHINE.search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}")
    assert found == []


def test_no_tracked_file_is_large() -> None:
    assert [path.name for path in tracked_files() if path.stat().st_size > 2**20] == []


def test_the_lock_pins_every_requirement_by_hash_and_names_no_place() -> None:
    lock = (ROOT / "requirements.lock").read_text("utf-8")
    assert "://" not in lock
    requirements = re.sub(r"\\\n", " ", re.sub(r"(?m)^\s*#.*\n", "", lock)).splitlines()
    assert len(requirements) > 20
    for requirement in requirements:
        assert re.match(r"[a-z0-9-]+==\S+", requirement), requirement
        assert "--hash=sha256:" in requirement, requirement


def test_the_lock_covers_what_the_project_asks_for() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    groups = project["dependency-groups"]
    developers = [name for name in groups["dev"] if isinstance(name, str)]
    asked = project["project"]["dependencies"] + groups["docs"] + developers
    pinned = set(re.findall(r"(?m)^([a-z0-9-]+)==", (ROOT / "requirements.lock").read_text("utf-8")))
    ours = {"stone-client"}  # of the same checkout
    assert {re.split(r"[<>=!~\[]", name)[0].replace(".", "-") for name in asked} <= pinned | ours


PARTS_OF_CHECK = ("check", "check-tests", "check-beside", "style", "static")


def test_make_check_runs_every_guard_and_ci_runs_make_check() -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    recipes = {target: makefile[makefile.index(f"\n{target}:") :].partition("\n\n")[0] for target in PARTS_OF_CHECK}
    check, run = recipes["check"], "\n".join(recipes.values())
    for guard in (
        "ruff format --check",
        "ruff check",
        "mypy",
        "lint-imports",
        "deptry",
        "test-kernels",
        '-m "not release"',
    ):
        assert guard in run
    assert re.match(r"\ncheck: [^\n]*\bstyle\n", check)
    assert " check-tests check-beside\n" in check
    assert " static test-kernels test-baselines" in recipes["check-beside"]
    assert re.search(r"(?m)^\t\$\(BIN\)/pytest \$\(BESIDE\)$", makefile), "test-all leaves nothing out"
    assert not re.search(r"\|\||\| |^\t-", run, re.MULTILINE), "a guard's failure must stop make"
    assert "make --no-print-directory check" in (ROOT / ".ci" / "run").read_text("utf-8")
    assert "make check" in (ROOT / "CONTRIBUTING.md").read_text("utf-8")


def test_every_make_target_that_runs_something_installs_first() -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    for target in ("demo", "serve", "test-clients", "test", "test-all", "test-kernels", "check", "chaos", "bench"):
        assert re.search(rf"(?m)^{target}: (install|develop|platform|test-clients)( style)?$", makefile)


# Those below docs/ lead to made pages too: tests/docsite follows them in the built site.
@pytest.mark.parametrize("page", sorted(ROOT.glob("*.md")), ids=lambda p: p.name)
def test_the_pages_point_at_what_exists(page: Path) -> None:
    for link in re.findall(r"\]\(([^)#]+)", page.read_text("utf-8")):
        assert link.startswith("https://") or (page.parent / link).exists(), link


def is_command(words: Sequence[str], places: Sequence[Place] = COMMANDS) -> bool:
    """Whether the words begin with those of a command, below its groups."""
    found = next((place for place in places if words and place.word == words[0]), None)
    return is_command(words[1:], found.places) if isinstance(found, GroupPlace) else found is not None


@pytest.mark.parametrize("page", sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]), ids=lambda p: p.name)
def test_the_pages_name_only_commands_and_targets_that_exist(page: Path) -> None:
    text = page.read_text("utf-8")
    named = [words.split() for words in re.findall(r"bin/stone ([a-z][\w-]*(?: [a-z][\w-]*)*)", text)]
    targets = set(re.findall(r"(?m)^([\w-]+):", (ROOT / "Makefile").read_text("utf-8")))
    assert [words for words in named if not is_command(words_of_today(words)[0])] == []
    assert set(re.findall(r"(?m)(?:`|^)make ([\w-]+)", text)) <= targets


GRID_HOMES = {
    "stone_base/label_grid.py",
    "api/schemas/grids.py",  # examples of the API
    "simulator/verdict.py",  # an oracle, which is made without the platform
}


def test_a_grid_has_one_home() -> None:
    """No extent or shape of the paper's grid stands elsewhere: a program that knows one grid knows it by its value."""
    found = set[str]()
    for path in SOURCES:
        name = path.relative_to(ROOT).as_posix()
        if name.startswith(("chaos/", "fuzz/", "testing/")) or name in GRID_HOMES:
            continue
        for node in nodes_of(path):
            is_extent = isinstance(node, ast.Constant) and node.value in (25.6, 51.2)
            sides = [getattr(one, "value", None) for one in node.elts] if isinstance(node, ast.Tuple | ast.List) else []
            if is_extent or sides in ([256, 256, 32], [200, 200, 16]):
                found.add(f"{name}:{getattr(node, 'lineno', 0)}")
    assert found == set()
