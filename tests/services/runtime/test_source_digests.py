"""A digest follows what is computed: nothing else changes it, and every change of the computation does.

The sources are small packages written here; what is reached of the real ones is in `test_source_reach.py`.
"""

import re
import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest

from services.runtime.source_digests import (
    Reach,
)
from services.runtime.source_tree import Definition, SourceTree, place_of
from testing.refusals import refused_as

ROOT = Path(__file__).resolve().parents[3]
Files = Mapping[str, str]
BASE: Files = {
    "run.py": """
from pack.deep.tools import scaled as changed, LIMIT
import pack.deep.tables as tables

def compute(values: list[float], *, factor=2):
    total = 0
    for value in values:
        part = changed(value, factor)
        total += part if part < LIMIT else tables.PLACES["low"]
    return [total - value for value in values]
""",
    "deep/__init__.py": "",
    "deep/tools.py": """
from dataclasses import dataclass

LIMIT = 100
UNUSED = 1

@dataclass(frozen=True)
class Scale:
    offset: float = 0.5

    def of(self, value, factor):
        return value * factor + self.offset

def scaled(value, factor):
    return even(value, factor) if value else Scale().of(value, factor)

def even(value, factor):
    return scaled(value - 1, factor)

def other(value, factor):
    return value - factor
""",
    "deep/tables.py": 'PLACES = {"low": 1, "high": 2}\n',
}


def digest(folder: Path, files: Files, entry: str = "pack.run:compute") -> str:
    """The digest of a package with these files."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, text in {"__init__.py": "", **files}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    reach = Reach(SourceTree({"pack": folder}))
    reach.add([Definition(*entry.split(":"))])
    return reach.digest()


def edited(name: str, old: str, new: str) -> Files:
    assert BASE[name].count(old) == 1, f"{old!r} in {name}"
    return {**BASE, name: BASE[name].replace(old, new)}


def moved(old: str, new: str) -> Files:
    """The file under another name, and its importers changed."""
    module = {name: "pack." + name.removesuffix(".py").replace("/", ".") for name in (old, new)}
    files = {new if name == old else name: text for name, text in BASE.items()}
    return {name: text.replace(module[old], module[new]) for name, text in files.items()}


MERGED: Files = {
    "run.py": BASE["deep/tools.py"].replace("even", "_even")
    + BASE["deep/tables.py"]
    + """
def compute(values: list[float], *, factor=2):
    total = 0
    for value in values:
        part = scaled(value, factor)
        total += part if part < LIMIT else PLACES["low"]
    return [total - value for value in values]
""",
}
UNCHANGED: Mapping[str, Files] = {
    "a docstring": edited("run.py", "    total = 0\n", '    """Sum up."""\n    total = 0\n'),
    "a comment and blank lines": edited("run.py", "    total = 0\n", "\n    # a remark\n\n    total = 0\n"),
    "a text under a constant": edited("deep/tools.py", "LIMIT = 100\n", 'LIMIT = 100\n"""The largest."""\n'),
    "another layout": edited("deep/tables.py", '{"low": 1, "high": 2}', '{\n    "low": 1,\n    "high": 2,\n}'),
    "a local name": {**BASE, "run.py": re.sub(r"\bvalue\b", "number", BASE["run.py"].replace("part", "share"))},
    "the name of a function": {
        name: text.replace("scaled", "stretched").replace("even", "uneven") for name, text in BASE.items()
    },
    "the name of a class": {name: text.replace("Scale", "Stretch") for name, text in BASE.items()},
    "the name of a file": moved("deep/tables.py", "deep/places.py"),
    "the folder of a file": moved("deep/tools.py", "tools.py"),
    "all in one file, a private name changed": MERGED,
    "an import of the name, not of the module": {
        **BASE,
        "run.py": BASE["run.py"]
        .replace("import pack.deep.tables as tables", "from pack.deep.tables import PLACES")
        .replace("tables.PLACES", "PLACES"),
    },
    "an import where it is needed": edited(
        "run.py", "    total = 0\n", "    from pack.deep.tools import LIMIT\n    total = 0\n"
    ),
    "a type in quotes": edited("run.py", "values: list[float]", 'values: "list[float]"'),
    "what nothing reaches": edited("deep/tools.py", "return value - factor", "return value + factor"),
    "a constant that nothing reads": edited("deep/tools.py", "UNUSED = 1", "UNUSED = 2"),
    "a module that nothing imports": {**BASE, "deep/more.py": "LIMIT = 7\nprint(LIMIT)\n"},
    "a document": {**BASE, "deep/README.md": "words\n"},
}
CHANGED: Mapping[str, Files] = {
    "a constant": edited("deep/tools.py", "LIMIT = 100", "LIMIT = 101"),
    "the type of a constant": edited("deep/tools.py", "LIMIT = 100", "LIMIT = 100.0"),
    "an operator": edited("deep/tools.py", "value * factor + self", "value * factor - self"),
    "a comparison": edited("run.py", "part < LIMIT", "part <= LIMIT"),
    "the default of a parameter": edited("run.py", "factor=2", "factor=3"),
    "the default of a field": edited("deep/tools.py", "offset: float = 0.5", "offset: float = 0.25"),
    "the option of a decorator": edited("deep/tools.py", "frozen=True", "frozen=False"),
    "another function is called": edited("run.py", "scaled as changed", "other as changed"),
    "a deeper function is called": edited("deep/tools.py", "return even(value", "return other(value"),
    "arguments in another order": edited("run.py", "changed(value, factor)", "changed(factor, value)"),
    "local variables exchanged": edited("run.py", "[total - value for", "[value - total for"),
    "a key": edited("run.py", '["low"]', '["high"]'),
    "the order of statements": edited(
        "run.py", "    total = 0\n    for value in values:", "    for value in values:\n        total = 0"
    ),
    "the name of a parameter": edited(
        "deep/tools.py",
        "def of(self, value, factor):\n        return value * factor",
        "def of(self, v, f):\n        return v * f",
    ),
    "the name of an attribute": {name: text.replace("offset", "shift") for name, text in BASE.items()},
    "what runs at import": edited("deep/tables.py", "PLACES =", "print('here')\nPLACES ="),
    "a decorator that registers": {
        **BASE,
        "deep/tables.py": "import atexit\n"
        + BASE["deep/tables.py"]
        + "\n@atexit.register\ndef end():\n    PLACES.clear()\n",
    },
    "an item is added at import": {**BASE, "deep/tables.py": BASE["deep/tables.py"] + 'PLACES["low"] = 3\n'},
    "a name that is bound again": {**BASE, "deep/tools.py": BASE["deep/tools.py"] + "LIMIT += 1\n"},
    "two constants that change places": edited("deep/tables.py", '"low": 1, "high": 2', '"low": 2, "high": 1'),
}


@pytest.mark.parametrize("files", UNCHANGED.values(), ids=UNCHANGED)
def test_what_does_not_compute_changes_no_digest(files: Files, tmp_path: Path) -> None:
    assert digest(tmp_path / "pack", files) == digest(tmp_path / "pack", BASE)


@pytest.mark.parametrize("files", CHANGED.values(), ids=CHANGED)
def test_what_computes_changes_the_digest(files: Files, tmp_path: Path) -> None:
    assert digest(tmp_path / "pack", files) != digest(tmp_path / "pack", BASE)


CAUGHT = """try:
        y = 1
    except ValueError:
        y = 2"""
MATCHED = """match KEPT:
        case [a, *b]: y = a
        case _: y = 0"""
BODIES = {
    CAUGHT: CAUGHT.replace("ValueError", "TypeError"),
    MATCHED: MATCHED.replace("y = a", "y = b"),
    "for x in range(3): y = x": "for x in range(4): y = x",
    "y = [x for x in [1]]": "y = {x for x in [1]}",
    "y = lambda a, b: a": "y = lambda a, b: b",
    "y = f'{1.5:.2f}'": "y = f'{1.5:.3f}'",
    "y = f'{1!r}'": "y = f'{1!s}'",
    "y = (z := 3) + 1": "y = (z := 3) + 2",
    "y = HELD": "y = KEPT",
    "global HELD\n    HELD = 5\n    y = HELD": "HELD = 5\n    y = HELD",
    "y = inner()\n    HELD = 1": "y = inner()",
    "y = np.floor(2.5)": "y = np.ceil(2.5)",
    "y = len([])": "y = sum([])",
    "y = -1 ** 2": "y = (-1) ** 2",
    "y = 1 if HELD else 2": "y = 2 if HELD else 1",
    "y = b'a'": "y = 'a'",
    "y = True": "y = 1",
    "y = dict(a=1)": "y = dict(b=1)",
    "y = [*KEPT]": "y = [KEPT]",
    "y = KEPT[1:2]": "y = KEPT[1:]",
    "from math import sin\n    y = sin(1)": "from math import cos\n    y = cos(1)",
    "import math as m\n    y = m.sin(1)": "import cmath as m\n    y = m.sin(1)",
    "y = [a for a in [1] for b in [2]]": "y = [b for a in [1] for b in [2]]",
    "def f(q):\n        return q + 1\n    y = f(2)": "def f(q):\n        return q + 2\n    y = f(2)",
    "y = inner.__name__": "y = inner.__doc__",
    "del HELD\n    y = 1": "y = 1",
}
BODY = """
import numpy as np
HELD, KEPT = 1, [2]
def inner():
    return HELD
def compute():
    {}
    return y
"""


@pytest.mark.parametrize("pair", BODIES.items(), ids=[body.partition("\n")[0] for body in BODIES])
def test_every_kind_of_statement_counts(pair: tuple[str, str], tmp_path: Path) -> None:
    """Each pair is valid Python that computes something else."""
    texts = [BODY.format(body) for body in pair]
    for text in texts:
        compile(text, "run.py", "exec")
    first, second = (digest(tmp_path / "pack", {"run.py": text}) for text in texts)
    assert first != second


def test_equal_functions_count_once(tmp_path: Path) -> None:
    """Catches alone results that are made again since a copy of a function was deleted."""
    halved = "def halved(value):\n    return value / 2\n"
    copied = "def _half(value):\n    return value / 2\n"
    twice = "from pack.more import halved\n" + copied + "def compute(a, b):\n    return halved(a), _half(b)\n"
    once = "from pack.more import halved\ndef compute(a, b):\n    return halved(a), halved(b)\n"
    first, second = (digest(tmp_path / "pack", {"run.py": text, "more.py": halved}) for text in (twice, once))
    assert first == second


def test_a_local_name_hides_the_modules(tmp_path: Path) -> None:
    """Catches alone a local variable that is taken for the constant of the same name, and the other way."""
    local = {"run.py": "HELD = 1\ndef compute():\n    HELD = 2\n    return HELD\n"}
    other = {"run.py": "HELD = 3\ndef compute():\n    HELD = 2\n    return HELD\n"}
    read = {"run.py": "HELD = 1\ndef compute():\n    held = 2\n    return HELD\n"}
    assert digest(tmp_path / "pack", local) == digest(tmp_path / "pack", other)
    assert digest(tmp_path / "pack", local) != digest(tmp_path / "pack", read)


def test_a_module_that_a_string_names_counts(tmp_path: Path) -> None:
    table = 'FORMATS = {"a": "pack.more:write"}\ndef compute(name):\n    return FORMATS[name]\n'
    more = "def write():\n    return {}\n"
    first, second = (digest(tmp_path / "pack", {"run.py": table, "more.py": more.format(n)}) for n in (1, 2))
    assert first != second


@pytest.mark.parametrize("reader", ["Path(__file__).parent", 'files("pack.deep")'])
def test_data_files_count_by_their_bytes_and_names(reader: str, tmp_path: Path) -> None:
    code = f"from importlib.resources import files\nfrom pathlib import Path\ndef compute():\n    return {reader}\n"
    folder = "" if "__file__" in reader else "deep/"
    files = {"run.py": code, "deep/__init__.py": "", f"{folder}types/A.msg": "uint8 a\n", "deep/README.md": "words"}
    renamed = {name.replace("A.msg", "B.msg"): text for name, text in files.items()}
    found = digest(tmp_path / "pack", files)
    assert digest(tmp_path / "pack", {**files, f"{folder}types/A.msg": "uint8 b\n"}) != found
    assert digest(tmp_path / "pack", renamed) != found
    assert digest(tmp_path / "pack", {**files, "deep/README.md": "other words"}) == found


def test_a_name_that_nothing_defines_is_an_error(tmp_path: Path) -> None:
    with refused_as("unresolved_name", match=r"pack\.run defines no missing"):
        digest(tmp_path / "pack", {"run.py": "def compute():\n    return missing()\n"})


@pytest.mark.parametrize("entry", ["pack.gone:compute", "other.run:compute"])
def test_a_module_that_is_not_there_is_named(entry: str, tmp_path: Path) -> None:
    with refused_as("sources_missing", match=f"no source file of {entry.partition(':')[0]}"):
        digest(tmp_path / "pack", BASE, entry)
    with refused_as("sources_missing", match="no source file of nothing_at_all"):
        place_of("nothing_at_all")
