"""Which distributions a module needs: every import statement on the way from it, those within functions too."""

import ast
import sys
from collections.abc import Iterable
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[3]
OWN = {
    "stone", "stone_base", "stone_files", "stone_recordings", "stone_submissions", "stone_exports",
    "stone_datasets", "baselines",
    "services", "simulator", "stone_client", "stone_local", "api", "web",
}  # fmt: skip
FOR_TYPES_ONLY = {"types_boto3_s3"}


def needed_distributions(modules: Iterable[str]) -> dict[str, str]:
    """Every distribution that is imported on the way from `modules`, and one module that imports it."""
    known = packages_distributions()
    found: dict[str, str] = {}
    for package, importer in imported_packages(modules).items():
        for distribution in known.get(package, [package]):
            found[canonicalize_name(distribution)] = importer
    return found


def imported_packages(modules: Iterable[str]) -> dict[str, str]:
    """Every top-level package of others that is imported on the way, and one module that imports it."""
    outside: dict[str, str] = {}
    for module in reached(modules):
        for name in _imports(module):
            package = name.partition(".")[0]
            if package not in OWN | FOR_TYPES_ONLY and package not in sys.stdlib_module_names:
                outside[package] = module
    return outside


def reached(modules: Iterable[str]) -> set[str]:
    """The modules of ours that are imported on the way, `modules` among them."""
    seen: set[str] = set()
    todo = list(modules)
    while todo:
        module = todo.pop()
        if module in seen or _path(module) is None:
            continue
        seen.add(module)
        parents = module.split(".")
        todo += [".".join(parents[:count]) for count in range(1, len(parents))]
        todo += [name for name in _imports(module) if name.partition(".")[0] in OWN]
    return seen


@cache
def _imports(module: str) -> frozenset[str]:
    path = _path(module)
    assert path is not None
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(found)


def _path(module: str) -> Path | None:
    place = ROOT.joinpath(*module.split("."))
    return next((path for path in (place.with_suffix(".py"), place / "__init__.py") if path.exists()), None)
