"""The computation of a definition, as text that changes only with the computation.

**Conventions.** The text is the syntax tree of the definition without docstrings, positions, imports and local names. A
reference to another definition of the platform is a mark in the text, with the definition in a separate list, so its
name and its file do not matter. Names that programs can look up stay: parameters, attributes, keywords, strings.
"""

import ast
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from services.runtime.source_tree import (
    EFFECTS,
    Definition,
    External,
    Import,
    ModuleObject,
    SourceTree,
    Target,
    imports_of,
    names_in,
)

SKIPPED = frozenset({"ctx", "simple"})
PLACE = re.compile(r"[a-z_]\w*(?:\.\w+)+(?::\w+)?")
"""A string that may name a module of the platform, or an object in it (`package.module:function`)."""
DATA_READERS = ("__file__", "importlib.resources")


@dataclass
class Computation:
    """`text` is a definition's computation, `references` the definitions in it, in the order of the text.

    `loaded` are the modules that it imports at run time, `libraries` the other top-level packages that it refers to.
    `data` are the packages whose data files it may read; "" is its own package.
    """

    text: str = ""
    references: list[Definition] = field(default_factory=list)
    loaded: set[str] = field(default_factory=set)
    libraries: set[str] = field(default_factory=set)
    data: set[str] = field(default_factory=set)


def computation_of(tree: SourceTree, definition: Definition) -> Computation:
    """Return the computation of a definition. Raises `unresolved_name`, `sources_missing`."""
    writer = _Writer(tree, definition)
    writer.write(tree.module(definition.module).statements.get(definition.name, []))
    made = writer.made
    made.text = " ".join(writer.words)
    if not writer.reads_data:
        made.data.clear()
    elif not made.data:
        made.data.add("")
    return made


@dataclass
class _Scope:
    """The names of a function, a class body or a comprehension. The attributes of a class keep their names."""

    bound: set[str]
    imports: dict[str, Import] = field(default_factory=dict)
    is_class: bool = False
    ordinals: dict[str, int] = field(default_factory=dict)


class _Writer:
    """A writer of the words of one definition."""

    def __init__(self, tree: SourceTree, definition: Definition) -> None:
        self.tree, self.definition = tree, definition
        self.words: list[str] = []
        self.made = Computation()
        self.reads_data = False
        self._scopes: list[_Scope] = []
        self._locals = 0

    def write(self, nodes: Sequence[ast.AST]) -> None:
        for node in nodes:
            self._node(node)

    def _node(self, node: ast.AST) -> None:
        match node:
            case ast.Import() | ast.ImportFrom():
                self._load(node)
            case ast.Expr(value=ast.Constant(value=str())) | ast.Pass() | ast.Global() | ast.Nonlocal():
                pass
            case ast.Name():
                self._name(node.id)
            case ast.Attribute():
                self._attribute(node)
            case ast.Constant(value=str(text)):
                self._string(text)
            case ast.Constant():
                self.words.append(f"{type(node.value).__name__}:{node.value!r}")
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.Lambda():
                self._function(node)
            case ast.ClassDef():
                self._class(node)
            case ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp():
                self._comprehension(node)
            case _:
                self._other(node)

    def _other(self, node: ast.AST) -> None:
        """Write type and fields; a field that is a name of the scope is written as a name."""
        is_named = isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar)
        self.words.append(f"({type(node).__name__}")
        for name, value in ast.iter_fields(node):
            if name in SKIPPED or value is None or value == []:
                continue
            self.words.append(f"{name}=")
            if isinstance(value, ast.AST):
                self._annotation(value) if name == "annotation" else self._node(value)
            elif (is_named and name == "name") or (isinstance(node, ast.MatchMapping) and name == "rest"):
                self._name(value)
            elif isinstance(value, list):
                self._list(value)
            else:
                self.words.append(repr(value))
        self.words.append(")")

    def _list(self, values: Sequence[object]) -> None:
        self.words.append("[")
        for value in values:
            if isinstance(value, ast.AST):
                self._node(value)
            else:
                self.words.append(repr(value))
        self.words.append("]")

    def _annotation(self, node: ast.AST) -> None:
        """Write a type; a quoted type is the same type."""
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            node = ast.parse(node.value, mode="eval").body
        self._node(node)

    def _name(self, name: str) -> None:
        meaning = self._meaning(name)
        if isinstance(meaning, str):
            self.words.append(meaning)
        else:
            self._target(meaning)

    def _meaning(self, name: str) -> Target | str:
        """Return the target of a name, or its word if it is a local variable or an attribute of a class body."""
        for scope in reversed(self._scopes):
            if name not in scope.bound or (scope.is_class and scope is not self._scopes[-1]):
                continue
            if name in scope.imports:
                return self.tree.imported(scope.imports[name])
            if scope.is_class:
                return f"own:{name}"
            if name not in scope.ordinals:
                scope.ordinals[name], self._locals = self._locals, self._locals + 1
            return f"local:{scope.ordinals[name]}"
        return self.tree.resolved(self.definition.module, name)

    def _target(self, target: Target) -> None:
        match target:
            case Definition():
                self.words.append("self" if target == self.definition else "definition")
                self.made.references.append(target)
                self.made.loaded.add(target.module)
            case ModuleObject(module):
                self.words.append("module")
                self.made.loaded.add(module)
                defined = sorted(set(self.tree.module(module).statements) - {EFFECTS})
                self.made.references += [Definition(module, name) for name in defined]
            case External(name, library):
                self.words.append(f"external:{name}")
                self.made.libraries.add(library)
                self.reads_data |= name.startswith(DATA_READERS)

    def _attribute(self, node: ast.Attribute) -> None:
        target = self._module_member(node)
        if target is not None:
            self._target(target)
            return
        self.words.append(f"(Attribute {node.attr}")
        self._node(node.value)
        self.words.append(")")

    def _module_member(self, node: ast.expr) -> Target | None:
        """Return the target of `module.name`, or None for an attribute of something else."""
        if isinstance(node, ast.Name):
            meaning = self._meaning(node.id)
            return None if isinstance(meaning, str) else meaning
        if not isinstance(node, ast.Attribute):
            return None
        base = self._module_member(node.value)
        if not isinstance(base, ModuleObject):
            return None
        return self.tree.imported(Import(base.module, node.attr))

    def _string(self, text: str) -> None:
        """Write a string; a string that names an object of the platform refers to it."""
        module, _, name = text.partition(":")
        if PLACE.fullmatch(text) and self.tree.is_inside(module) and self.tree.path_of(module) is not None:
            if self.tree.module(module).is_package:
                self.made.data.add(module)
            self._target(self.tree.resolved(module, name) if name else ModuleObject(module))
        else:
            self.words.append(f"str:{text!r}")

    def _load(self, node: ast.Import | ast.ImportFrom) -> None:
        for _, target, loaded in imports_of(node):
            self.made.loaded |= {loaded, f"{target.module}.{target.name}"}

    @contextmanager
    def _scope(self, scope: _Scope) -> Iterator[None]:
        self._scopes.append(scope)
        yield
        self._scopes.pop()

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) -> None:
        self.words.append(f"({type(node).__name__}")
        if not isinstance(node, ast.Lambda):
            if self._scopes:
                self._name(node.name)
            self._list(node.decorator_list)
            if node.returns is not None:
                self._annotation(node.returns)
        arguments, body = node.args, [node.body] if isinstance(node, ast.Lambda) else node.body
        self._list(arguments.defaults)
        self._list([default if default is not None else "required" for default in arguments.kw_defaults])
        taken = _arguments(arguments)
        for argument in taken:
            if argument.annotation is not None:
                self.words.append("annotation=")
                self._annotation(argument.annotation)
        self.words.append(f"{len(arguments.posonlyargs)},{len(arguments.args)},{len(arguments.kwonlyargs)}")
        self.words.append(f"{arguments.vararg is not None},{arguments.kwarg is not None}")
        with self._scope(_body_scope(body, {argument.arg for argument in taken})):
            for argument in taken:
                self.words.append(argument.arg)
                self._name(argument.arg)
            self.write(body)
        self.words.append(")")

    def _class(self, node: ast.ClassDef) -> None:
        self.words.append("(ClassDef")
        if self._scopes:
            self._name(node.name)
        for expressions in (node.decorator_list, node.bases, node.keywords):
            self._list(expressions)
        with self._scope(_body_scope(node.body, set(), is_class=True)):
            self.write(node.body)
        self.words.append(")")

    def _comprehension(self, node: ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp) -> None:
        """Write a comprehension; the first iterable belongs to the outer scope, as in Python."""
        first = node.generators[0]
        self.words.append(f"({type(node).__name__}")
        self._node(first.iter)
        targets = [generator.target for generator in node.generators]
        with self._scope(_Scope(names_in(targets).bound)):
            for generator in node.generators:
                self.words.append(f"for {generator.is_async}")
                self._node(generator.target)
                if generator is not first:
                    self._node(generator.iter)
                self._list(generator.ifs)
            results = [node.key, node.value] if isinstance(node, ast.DictComp) else [node.elt]
            self.write(results)
        self.words.append(")")


def _body_scope(body: Sequence[ast.AST], parameters: set[str], *, is_class: bool = False) -> _Scope:
    """Return the scope of a body with these parameters, without global and nonlocal names."""
    names = names_in(body)
    imports = {name: target for statement in names.imports for name, target, _ in imports_of(statement)}
    return _Scope((names.bound | parameters | set(imports)) - names.declared, imports, is_class)


def _arguments(arguments: ast.arguments) -> list[ast.arg]:
    """Return all parameters, always in the same order."""
    single = [argument for argument in (arguments.vararg, arguments.kwarg) if argument is not None]
    return [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, *single]
