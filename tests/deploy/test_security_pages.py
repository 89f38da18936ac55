"""What the pages on security name is there: every file, every test, every setting."""

import re
from pathlib import Path

import pytest

from services.runtime.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs" / "security").glob("*.md"))
PLACE = re.compile(r"`((?:api|deploy|services|stone|tests|web)/[\w./-]+|requirements\.lock)(?:::(\w+))?`")
SETTING = re.compile(r"`STONE_(\w+?)__(\w+)`")


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


def test_the_pages_name_many() -> None:
    assert sum(len(PLACE.findall(page.read_text("utf-8"))) for page in PAGES) > 150


def test_every_setting_that_the_pages_name_exists() -> None:
    named = {found for page in PAGES for found in SETTING.findall(page.read_text("utf-8"))}
    assert named
    settings = Settings()
    unknown = [name for group, name in named if not hasattr(getattr(settings, group.lower(), None), name.lower())]
    assert unknown == []


def test_every_threat_has_a_mitigation_and_a_proof() -> None:
    page = (ROOT / "docs" / "security" / "threat-model.md").read_text("utf-8")
    rows = [line.split("|")[1:-1] for line in page.splitlines() if re.match(r"\| [STRIDE] \|", line)]
    assert {row[0].strip() for row in rows} == set("STRIDE")
    assert [row[1] for row in rows if len(row) != 5 or not row[2].strip() or not PLACE.search(row[3])] == []
