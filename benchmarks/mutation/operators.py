"""Mutation operators: for a node of the syntax, the other text that would stand there if somebody had made a mistake.

**Conventions.** A change is (name of the operator, new text of the node). Types, docstrings and texts are not changed.
A comparison is moved by its boundary (`<` to `<=`) or turned round (`<` to `>=`), by chance.
"""

import ast
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

Change = tuple[str, str]
BOUNDARY: dict[type[ast.cmpop], type[ast.cmpop]] = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
OPPOSITE: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
}
REMOVABLE = (ast.Assign, ast.AugAssign, ast.Expr, ast.Raise, ast.Delete)


@dataclass(frozen=True)
class Place:
    """A node that may be changed, the function that it stands in, and every change that may be made there."""

    node: ast.expr | ast.stmt
    function: str
    changes: tuple[Change, ...]


def places_of(tree: ast.Module) -> Iterator[Place]:
    """Every place of a module, in the order of its syntax."""
    yield from _within(tree.body, "<module>")


def _within(nodes: Sequence[ast.AST], function: str) -> Iterator[Place]:
    for node in nodes:
        if isinstance(node, ast.expr | ast.stmt) and (changes := tuple(_changes(node))):
            yield Place(node, function, changes)
        if isinstance(node, ast.If | ast.While) and isinstance(node.test, ast.Name | ast.Attribute | ast.Call):
            yield Place(node.test, function, (("condition", f"(not {ast.unparse(node.test)})"),))
        yield from _within(list(_children(node)), _named(node, function))


def _named(node: ast.AST, function: str) -> str:
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return function
    return node.name if function == "<module>" else f"{function}.{node.name}"


def _children(node: ast.AST) -> Iterator[ast.AST]:
    """What of a node runs: no types, no decorators, nothing inside of a text."""
    left_out = {"annotation", "returns", "decorator_list", "type_comment", "type_params"}
    if isinstance(node, ast.JoinedStr):
        return
    for name, value in ast.iter_fields(node):
        if name not in left_out:
            yield from (one for one in (value if isinstance(value, list) else [value]) if isinstance(one, ast.AST))


def _changes(node: ast.expr | ast.stmt) -> Iterator[Change]:
    for kind, changed in CHANGED_BY.items():
        if isinstance(node, kind):
            yield from changed(node)
    if isinstance(node, REMOVABLE) and _is_removable(node):
        yield "statement removed", "pass"


def _compared(node: ast.Compare) -> Iterator[Change]:
    for name, table in (("boundary", BOUNDARY), ("comparison", OPPOSITE)):
        if len(node.ops) == 1 and (other := table.get(type(node.ops[0]))):
            yield name, f"({ast.unparse(ast.Compare(node.left, [other()], node.comparators))})"


def _calculated(node: ast.BinOp) -> Iterator[Change]:
    is_text = isinstance(node.left, ast.JoinedStr) or (
        isinstance(node.left, ast.Constant) and isinstance(node.left.value, str | bytes)
    )
    if not is_text and (other := ARITHMETIC.get(type(node.op))):
        yield "arithmetic", f"({ast.unparse(ast.BinOp(node.left, other(), node.right))})"


def _signed(node: ast.UnaryOp) -> Iterator[Change]:
    if not isinstance(node.op, ast.UAdd):
        yield "not" if isinstance(node.op, ast.Not) else "sign", f"({ast.unparse(node.operand)})"


def _joined(node: ast.BoolOp) -> Iterator[Change]:
    other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
    yield "and/or", f"({ast.unparse(ast.BoolOp(other, node.values))})"


def _constant(node: ast.Constant) -> Iterator[Change]:
    if isinstance(node.value, bool):
        yield "boolean", str(not node.value)
    elif isinstance(node.value, int | float):
        yield "constant", f"{node.value + 1!r}"
        yield "constant", f"({node.value - 1!r})"


def _sliced(node: ast.Slice) -> Iterator[Change]:
    if node.lower is not None and not isinstance(node.lower, ast.Constant):
        yield "slice", ast.unparse(ast.Slice(_next(node.lower), node.upper, node.step))
    if node.upper is not None and not isinstance(node.upper, ast.Constant):
        yield "slice", ast.unparse(ast.Slice(node.lower, _next(node.upper), node.step))


def _next(bound: ast.expr) -> ast.expr:
    return ast.BinOp(bound, ast.Add(), ast.Constant(1))


def _returned(node: ast.Return) -> Iterator[Change]:
    if node.value is None:
        yield "return removed", "pass"
    elif not (isinstance(node.value, ast.Constant) and node.value.value is None):
        yield "return nothing", "return None"


def _conditional(node: ast.IfExp) -> Iterator[Change]:
    yield "condition", f"({ast.unparse(ast.IfExp(ast.UnaryOp(ast.Not(), node.test), node.body, node.orelse))})"


def _looped(node: ast.Break | ast.Continue) -> Iterator[Change]:
    yield "loop", "continue" if isinstance(node, ast.Break) else "break"


def _is_removable(node: ast.stmt) -> bool:
    """Calls, refusals and what changes something that others see; a name that is missing would die at once."""
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Call | ast.Await)
    if isinstance(node, ast.Assign):
        return all(isinstance(target, ast.Attribute | ast.Subscript) for target in node.targets)
    return True


CHANGED_BY: dict[type[ast.AST] | tuple[type[ast.AST], ...], Callable[..., Iterator[Change]]] = {
    ast.Compare: _compared,
    ast.BinOp: _calculated,
    ast.UnaryOp: _signed,
    ast.BoolOp: _joined,
    ast.Constant: _constant,
    ast.Slice: _sliced,
    ast.Return: _returned,
    ast.IfExp: _conditional,
    (ast.Break, ast.Continue): _looped,
}
