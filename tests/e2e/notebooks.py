"""A notebook's code cells as Jupyter runs them, without Jupyter: in one namespace, the last expression shown."""

import ast
from base64 import b64encode
from pathlib import Path
from typing import Any

SHOWN = {"text/html": "_repr_html_", "image/png": "_repr_png_"}


def run_cells(notebook: dict[str, Any]) -> dict[str, Any]:
    """Run every code cell; return the notebook with what it showed."""
    namespace: dict[str, Any] = {}
    number = 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            number += 1
            shown = _run("".join(cell["source"]), namespace)
            output = {"data": shown, "execution_count": number, "metadata": {}, "output_type": "execute_result"}
            cell |= {"execution_count": number, "outputs": [output] if shown else []}
    return notebook


def _run(source: str, namespace: dict[str, Any]) -> dict[str, str]:
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), namespace)
    value = None if last is None else eval(ast.unparse(last), namespace)
    return {} if value is None else _data_of(value)


def _data_of(value: Any) -> dict[str, str]:
    """Return the stored form of a value that a cell shows."""
    data = {"text/plain": repr(value)}
    for kind, name in SHOWN.items():
        if (made := getattr(value, name, lambda: None)()) is not None:
            data[kind] = b64encode(made).decode() if isinstance(made, bytes) else made
    return data


def kinds(notebook: dict[str, Any]) -> list[list[str]]:
    """Return the outputs of each code cell, by media type."""
    cells = (cell for cell in notebook["cells"] if cell["cell_type"] == "code")
    return [sorted(kind for output in cell["outputs"] for kind in output["data"]) for cell in cells]


NOTEBOOK = Path(__file__).resolve().parents[2] / "examples" / "sdk.ipynb"
