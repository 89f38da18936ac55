"""The analytic worlds share no code with what they judge."""

import ast
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[3] / "testing" / "outside"
OURS = {
    "stone", "stone_base", "stone_files", "stone_recordings", "stone_submissions", "stone_exports", "stone_datasets",
    "baselines", "services", "simulator", "stone_client", "stone_local", "api", "web", "benchmarks", "testing", "tests",
}  # fmt: skip
WRITES_RECORDINGS = "stone_recordings.messages.types.registry"


def imported_by(path: Path) -> set[str]:
    """Return the modules that a file imports."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or ".")
    return found


def test_the_outside_worlds_import_nothing_of_the_project_but_the_definitions_of_messages() -> None:
    modules = {name for path in FOLDER.glob("*.py") for name in imported_by(path)}
    ours = {name for name in modules if name.split(".")[0] in OURS and not name.startswith("testing.outside.")}
    assert ours == {WRITES_RECORDINGS}
