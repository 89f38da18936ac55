"""Common prediction layouts that are not a submission's: recognised by file names, each with a command that converts
it.

**Conventions.** A layout explains files by the tokens of their frames, as one problem of the archive instead of one
problem per file and frame. The commands read sub.zip and write fixed.zip.
"""

import re
from collections.abc import Callable, Mapping, Sequence

Explained = tuple[str, dict[str, str]]  # description of the files, and the token of each name

NUMBER = re.compile(r"[^0-9]{0,40}[0-9]{1,19}")
RUBBISH = ("__MACOSX/", ".DS_Store", "._", "Thumbs.db", "desktop.ini")
KEPT = "for n in a.namelist() if n.endswith('{ending}')"


def rezipped(name: str, kept: str = KEPT.format(ending=".npz"), before: str = "") -> str:
    """Return the command that writes every kept file under a new name, an expression of `n`."""
    return (
        f"python -c \"import zipfile as z; {before}a = z.ZipFile('sub.zip'); b = z.ZipFile('fixed.zip', 'w'); "
        f'[b.writestr({name}, a.read(n)) {kept}]; b.close()"'
    )


def resaved(array: str, name: str = "n", ending: str = ".npz") -> str:
    """Return the command that writes every frame with a converted array, an expression of `f` (the loaded npz)."""
    return (
        "python -c \"import io, zipfile as z, numpy as np; a = z.ZipFile('sub.zip'); b = z.ZipFile('fixed.zip', 'w'); "
        f"[(f := np.load(io.BytesIO(a.read(n))), g := io.BytesIO(), np.savez_compressed(g, semantics={array}), "
        f'b.writestr({name}, g.getvalue())) {KEPT.format(ending=ending)}]; b.close()"'
    )


NUMBERED = "files numbered instead of named by token"
OF_TOOLS = "files that macOS's Finder or Windows adds to a zip (`zip -r -X` does not)"
# The command for each kind of files; "" if there is none.
LINES: Mapping[str, str] = {
    "files in the label layout gts/<scene>/<token>/labels.npz": rezipped("n.split('/')[-2] + '.npz'"),
    "names with backslashes, as written by some Windows programs": rezipped("n.replace(chr(92), '/').split('/')[-1]"),
    "each frame in its own folder": rezipped("n.split('/')[-1]"),
    "arrays as .npy instead of .npz": resaved("f", "n[:-1] + 'z'", ".npy"),
    "tokens in upper case or with dashes": rezipped("n.split('/')[-1].lower().replace('-', '')"),
    NUMBERED: rezipped(
        "t.pop(0) + '.npz'",
        "for n in sorted(a.namelist()) if n.endswith('.npz')",
        "import json; t = sum(json.load(open('manifest.json'))['sequences'].values(), []); ",
    ),
    OF_TOOLS: rezipped("n", KEPT.format(ending=".npz") + " and '__MACOSX' not in n and '/._' not in '/' + n"),
}
(LABELS, BACKSLASHES, FOLDERS, NPY, DASHES, *_) = LINES


def other_layout(names: Sequence[str], missing: frozenset[str]) -> Explained | None:
    """Return the description of files that are not frames, for the layout that explains most; None if no layout does.

    `missing` are the tokens of missing frames.
    """
    names = [name for name in names if name.isprintable() and not {"", ".", ".."} & {*name.split("/")}]
    for what, token_of in _TOKENS.items():
        explained = {name: token for name in names if (token := token_of(name)) in missing}
        if explained:
            return what, explained
    numbered = sorted(name for name in names if name.endswith(".npz") and NUMBER.fullmatch(_stem(name)))
    if len(numbered) == len(missing) == sum(name.endswith(".npz") for name in names):
        return NUMBERED, dict(zip(numbered, sorted(missing), strict=True))
    return None


def is_rubbish(name: str) -> bool:
    """Return whether a file manager added this file to a zip."""
    return name.startswith(RUBBISH[0]) or name.rpartition("/")[2].startswith(RUBBISH[1:])


def layout_hint(found: str) -> str:
    """Return how to convert files that `other_layout` describes as `found`; "" for other descriptions."""
    line = next((line for what, line in LINES.items() if what in found), "")
    return f"name frames <frame_token>.npz and put all of them in one folder; {line}" if line else ""


def _stem(name: str) -> str:
    return name.replace("\\", "/").rpartition("/")[2].rpartition(".")[0]


def _parent(name: str) -> str:
    return name.replace("\\", "/").rpartition("/")[0].rpartition("/")[2]


_TOKENS: Mapping[str, Callable[[str], str]] = {
    LABELS: lambda name: _parent(name) if name.endswith(".npz") and "\\" not in name else "",
    BACKSLASHES: lambda name: _stem(name) if "\\" in name and name.endswith(".npz") else "",
    FOLDERS: lambda name: _stem(name) if "/" in name and name.endswith(".npz") else "",
    NPY: lambda name: _stem(name) if name.endswith(".npy") else "",
    DASHES: lambda name: _stem(name).lower().replace("-", "") if name.lower().endswith(".npz") else "",
}
