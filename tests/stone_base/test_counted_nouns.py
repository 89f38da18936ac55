"""No page, module or command writes a noun in the plural behind a number that may be one."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOUN = r"(?:sequences|frames|files|submissions|recordings|teams|entries|jobs)\b"
IN_TEMPLATES = re.compile(rf"\| (?:number|length) \}}\}} {NOUN}")
IN_MODULES = re.compile(rf"\$\{{[^{{}}]*\}} {NOUN}")
# Where the number is of several by what stands beside it, or of a whole phase, whose frames are many.
KNOWN = {
    "web/templates": ("> 1", "boards/", "admin/", "parts/admin.html", "of all "),
    "web/modules": ("=== 1", "> 1", "MOST_", "names.length", "most}", "count(all"),
}


def found(folder: str, suffix: str, pattern: re.Pattern[str]) -> list[str]:
    """`path: line` of each, but the known ones."""
    places = list[str]()
    for path in sorted((ROOT / folder).rglob(f"*.{suffix}")):
        name = path.relative_to(ROOT).as_posix()
        lines = [f"{name}: {line.strip()}" for line in path.read_text("utf-8").splitlines() if pattern.search(line)]
        places += [line[:200] for line in lines if not any(known in line for known in KNOWN[folder])]
    return places


@pytest.mark.parametrize(
    ("folder", "suffix", "pattern"), [("web/templates", "html", IN_TEMPLATES), ("web/modules", "ts", IN_MODULES)]
)
def test_numbers_are_counted_with_their_noun(folder: str, suffix: str, pattern: re.Pattern[str]) -> None:
    assert found(folder, suffix, pattern) == []
