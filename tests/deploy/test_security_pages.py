"""What the pages on security name is there: every file, every test, every setting."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs" / "security").glob("*.md"))
PLACE = re.compile(r"`((?:api|deploy|services|stone|tests|web)/[\w./-]+|requirements\.lock)(?:::(\w+))?`")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_file_and_test_that_a_page_names_is_there(page: Path) -> None:
    named = PLACE.findall(page.read_text("utf-8"))
    missing = [place for place, _ in named if not (ROOT / place).exists()]
    missing += [
        f"{place}::{test}"
        for place, test in named
        if test and (ROOT / place).is_file() and f"def {test}(" not in (ROOT / place).read_text("utf-8")
    ]
    assert missing == []
