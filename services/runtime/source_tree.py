"""The source files of this platform as modules: the statements that define each name, and the targets of imports.

**Conventions.** Modules are parsed once and never run. A `Definition` is identified by (module, name). A module outside
the packages, or below a package in `outside`, is not opened. Standard library only: the build of a wheel uses this
module before anything is installed (`deploy/images/digests_hook.py`).
"""

import ast
import builtins
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from stone_base.errors import Refused

EFFECTS = ""
"""The name of a module's statements that run at import and define nothing."""
UNNAMED = frozenset({"__all__"})
PURE_DECORATORS = frozenset({"cache", "contextmanager", "dataclass", "intrinsic", "lru_cache", "njit", "overload"})
"""Decorators that only change the function or class below them; other decorators may register it."""


class Definition(NamedTuple):
    """One name of one module."""

    module: str
    name: str


class ModuleObject(NamedTuple):
    """A module of the platform used as a value."""

    module: str


class External(NamedTuple):
    """An object that is not read, in a library, the standard library, or a module below `outside`.

    `library` is its top-level package, "" for builtins and for modules of the platform.
    """

    name: str
    library: str = ""


Target = Definition | ModuleObject | External


def sources_missing(name: str) -> Refused:
    return Refused(
        "sources_missing",
        f"no source file of {name} was found, so its results have no version; was it installed without sources?",
    )


@dataclass(frozen=True)
class Import:
    """The target of an imported name: a module, or an object in it if `name` is given."""

    module: str
    name: str = ""


@dataclass
class Module:
    """One source file. `statements` by the name that they define, in order; `imports` by the name they bind."""

    name: str
    path: Path
    statements: dict[str, list[ast.stmt]] = field(default_factory=dict)
    imports: dict[str, Import] = field(default_factory=dict)
    loaded: set[str] = field(default_factory=set)
    """The modules imported by importing this module."""

    @property
    def is_package(self) -> bool:
        return self.path.name == "__init__.py"


class SourceTree:
    """The modules of top-level packages in the folders `places`, except those below the packages `outside`."""

    def __init__(self, places: Mapping[str, Path], outside: Sequence[str] = ()) -> None:
        self._places = dict(places)
        self._outside = tuple(outside)
        self._modules: dict[str, Module] = {}

    def module(self, name: str) -> Module:
        """Return the module called `name`, parsed. Raises `sources_missing`."""
        if name not in self._modules:
            path = self.path_of(name)
            if path is None:
                raise sources_missing(name)
            self._modules[name] = _parsed(name, path)
        return self._modules[name]

    def path_of(self, name: str) -> Path | None:
        """Return the file of a module of the platform, or None if there is no such module."""
        root, *parts = name.split(".")
        if root not in self._places:
            return None
        base = self._places[root].joinpath(*parts)
        file = base.parent / f"{base.name}.py"
        return next((path for path in (base / "__init__.py", file) if path.is_file()), None)

    def is_inside(self, name: str) -> bool:
        """Return whether the module called `name` is opened."""
        is_outside = any(name == package or name.startswith(f"{package}.") for package in self._outside)
        return not is_outside and name.partition(".")[0] in self._places

    def resolved(self, module: str, name: str) -> Target:
        """Return the target of `name` in a module; imports are followed. Raises `unresolved_name`."""
        parsed = self.module(module)
        if name in parsed.statements:
            return Definition(module, name)
        if name in parsed.imports:
            return self.imported(parsed.imports[name])
        if parsed.is_package and self.path_of(f"{module}.{name}") is not None:
            return ModuleObject(f"{module}.{name}")
        if hasattr(builtins, name) or (name.startswith("__") and name.endswith("__")):
            return External(name)
        raise Refused(
            "unresolved_name", f"{module} defines no {name}; was it renamed or moved without updating its users?"
        )

    def imported(self, imported_name: Import) -> Target:
        """Return the target of an import. Raises `unresolved_name`, `sources_missing`."""
        root = imported_name.module.partition(".")[0]
        if root not in self._places:
            return External(
                f"{imported_name.module}.{imported_name.name}" if imported_name.name else imported_name.module, root
            )
        if not self.is_inside(imported_name.module):
            return External(imported_name.name or imported_name.module.rpartition(".")[2])
        return (
            self.resolved(imported_name.module, imported_name.name)
            if imported_name.name
            else ModuleObject(imported_name.module)
        )


def place_of(root: str) -> Path:
    """Return the folder of a top-level package without running it. Raises `sources_missing`."""
    spec = find_spec(root)
    if spec is None or not spec.submodule_search_locations:
        raise sources_missing(root)
    return Path(next(iter(spec.submodule_search_locations)))


def imports_of(node: ast.Import | ast.ImportFrom) -> Iterator[tuple[str, Import, str]]:
    """Yield (bound name, its target, loaded module) for each name of an import statement."""
    for alias in node.names:
        if isinstance(node, ast.ImportFrom):
            yield alias.asname or alias.name, Import(node.module or "", alias.name), node.module or ""
        elif alias.asname:
            yield alias.asname, Import(alias.name), alias.name
        else:
            root = alias.name.partition(".")[0]
            yield root, Import(root), alias.name


@dataclass
class ScopeNames:
    """The names that the statements of one scope bind, import, or declare global or nonlocal."""

    bound: set[str] = field(default_factory=set)
    imports: list[ast.Import | ast.ImportFrom] = field(default_factory=list)
    declared: set[str] = field(default_factory=set)


def names_in(nodes: Iterable[ast.AST]) -> ScopeNames:
    """Return the names that these nodes bind, import or declare in their own scope, without nested scopes."""
    names, todo = ScopeNames(), list(nodes)
    while todo:
        match node := todo.pop():
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                names.bound.add(node.name)
                continue
            case ast.Lambda():
                continue
            case ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp():
                names.bound |= {walrus.target.id for walrus in ast.walk(node) if isinstance(walrus, ast.NamedExpr)}
                continue
            case ast.Name(ctx=ast.Store() | ast.Del()):
                names.bound.add(node.id)
            case ast.Name() | ast.Constant():
                continue
            case ast.ExceptHandler(name=str(name)) | ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
                names.bound.add(name)
            case ast.MatchMapping(rest=str(name)):
                names.bound.add(name)
            case ast.Import() | ast.ImportFrom():
                names.imports.append(node)
            case ast.Global() | ast.Nonlocal():
                names.declared |= set(node.names)
        todo += ast.iter_child_nodes(node)
    return names


def _parsed(name: str, path: Path) -> Module:
    module = Module(name, path)
    for statement in ast.parse(path.read_bytes()).body:
        names = names_in([statement])
        for node in names.imports:
            for bound, target, loaded in imports_of(node):
                module.imports[bound] = target
                module.loaded |= {loaded, f"{target.module}.{target.name}"}
        for defined in _defined(statement, names.bound):
            module.statements.setdefault(defined, []).append(statement)
    return module


def _defined(statement: ast.stmt, bound: set[str]) -> set[str]:
    """Return the names that a module's statement defines; also `EFFECTS` if it may have other effects."""
    match statement:
        case ast.Import() | ast.ImportFrom() | ast.Expr(value=ast.Constant()) | ast.Pass():
            return set()
        case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
            is_pure = all(_name_of(decorator) in PURE_DECORATORS for decorator in statement.decorator_list)
            return {statement.name} if is_pure else {statement.name, EFFECTS}
        case ast.If(test=ast.Compare(left=ast.Name(id="__name__"))):  # the file's main program
            return set()
    is_definition = isinstance(statement, ast.Assign | ast.AnnAssign | ast.AugAssign) and bool(bound)
    is_condition_of_imports = isinstance(statement, ast.If) and all(
        isinstance(inner, ast.Import | ast.ImportFrom) for inner in (*statement.body, *statement.orelse)
    )
    return (bound if is_definition or is_condition_of_imports else bound | {EFFECTS}) - UNNAMED


def _name_of(decorator: ast.expr) -> str:
    """Return the last name of a decorator: `njit` for `@numba.njit(cache=True)`."""
    called = decorator.func if isinstance(decorator, ast.Call) else decorator
    return called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")


def source_files(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield the files below a folder by relative name, sorted, without compiled Python files."""
    for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
        path = Path(entry.path)
        if entry.is_dir():
            if entry.name != "__pycache__":
                yield from ((f"{entry.name}/{name}", file) for name, file in source_files(path))
        else:
            yield entry.name, path
