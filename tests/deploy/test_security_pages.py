"""Every test that the pages on security name is there; of their files, tests/test_references.py."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAMED_TEST = re.compile(r"`(tests/[\w./-]+)::(\w+)`")


def test_every_test_that_a_page_names_is_there() -> None:
    pages = [page.read_text("utf-8") for page in (ROOT / "docs" / "security").glob("*.md")]
    named = {place for page in pages for place in NAMED_TEST.findall(page)}
    assert len(named) > 10
    assert [one for one in named if f"def {one[1]}(" not in (ROOT / one[0]).read_text("utf-8")] == []
