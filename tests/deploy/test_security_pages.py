"""The pages on security hold: every test they name is there, and what ASVS rows say is absent is absent.

Of the files that they name, tests/test_references.py.
"""

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from api.middleware.context import COOKIE
from services.runtime.notifications.events import EVENTS, UNASKED
from services.runtime.orm import Base, User

ROOT = Path(__file__).resolve().parents[2]
NAMED_TEST = re.compile(r"`(tests/[\w./-]+)::(\w+)`")
ABSENT = re.compile(r"\b(none|not yet|no such|no second factor|no mail|there is no)\b")
"""Words by which a row claims that something does not exist."""
CLIENTS = {"http.client", "httpx", "requests", "urllib3", "urllib.request", "aiohttp", "smtplib", "ftplib"}
TO_OURSELVES = {
    "services/runtime/embedded/supervisor.py": "whether the API that it started answers",
    "services/runtime/processes/health_check.py": "whether the API of this container answers",
}
"""Modules with a client that sends to a process of ours alone."""


@dataclass(frozen=True)
class AsvsRow:
    """A row of the page; `how` and `gap` are what it claims."""

    number: str
    how: str
    test: str
    gap: str


def asvs_rows() -> list[AsvsRow]:
    page = (ROOT / "docs" / "developers" / "asvs.md").read_text("utf-8")
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines() if line.startswith("| ")]
    return [AsvsRow(number, how, test, gap) for number, _requirement, how, test, gap in cells if number[:1].isdigit()]


def row_of(number: str) -> AsvsRow:
    return next(row for row in asvs_rows() if row.number == number)


def product_files(*folders: str) -> Iterator[Path]:
    for folder in folders:
        yield from (path for path in (ROOT / folder).rglob("*.py") if "node_modules" not in path.parts)


def imported(path: Path) -> set[str]:
    nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
    whole = {name.name for node in nodes if isinstance(node, ast.Import) for name in node.names}
    return whole | {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}


def requests_are_made_where_the_row_says() -> None:
    """Would have found webhooks, of which the row said nothing for a release."""
    files = product_files("api", "services", "web")
    senders = {str(path.relative_to(ROOT)) for path in files if imported(path) & CLIENTS}
    named = {sender for sender in senders if f"`{sender}`" in row_of("5.2.6").how}
    assert senders - named == set(TO_OURSELVES)


def notifications_tell_of_no_credential() -> None:
    kinds = {kind.partition(".")[0] for kind in (*EVENTS, *UNASKED)}
    assert not kinds & {"user", "password", "token", "session", "credential", "account"}


def there_is_no_second_factor() -> None:
    columns = " ".join(column.name for table in Base.metadata.sorted_tables for column in table.columns)
    assert not re.search("otp|webauthn|factor|passkey", columns)


def no_password_ends_by_itself() -> None:
    assert not [column.name for column in User.__table__.columns if re.search("expire|must|password_.*ns", column.name)]


def the_cookie_has_no_prefix() -> None:
    assert not COOKIE.startswith("__Host-")


def no_header_shares_answers() -> None:
    shared = re.compile("access-control-allow|CORSMiddleware", re.IGNORECASE)
    assert [path for path in product_files("api", "web") if shared.search(path.read_text("utf-8"))] == []


HOLDS: dict[str, Callable[[], None]] = {
    "2.1.7": requests_are_made_where_the_row_says,
    "2.1.9, 2.1.10": no_password_ends_by_itself,
    "2.2.3": notifications_tell_of_no_credential,
    "2.7, 2.8": there_is_no_second_factor,
    "3.4.4": the_cookie_has_no_prefix,
    "4.3.1": there_is_no_second_factor,
    "5.2.6": requests_are_made_where_the_row_says,
    "14.5.3": no_header_shares_answers,
}
"""The check that would find what a row says is absent."""


def test_every_test_that_a_page_names_is_there() -> None:
    pages = [page.read_text("utf-8") for page in (ROOT / "docs").rglob("*.md")]
    named = {place for page in pages for place in NAMED_TEST.findall(page)}
    assert len(named) > 10
    assert [one for one in named if f"def {one[1]}(" not in (ROOT / one[0]).read_text("utf-8")] == []


def test_every_row_that_claims_an_absence_has_a_check_that_would_find_the_thing() -> None:
    claiming = {row.number for row in asvs_rows() if ABSENT.search(row.how) or ABSENT.search(row.gap)}
    assert claiming == set(HOLDS)


@pytest.mark.parametrize("number", HOLDS)
def test_what_a_row_says_is_absent_is_absent(number: str) -> None:
    HOLDS[number]()


def test_every_row_names_a_test_or_a_gap() -> None:
    assert [row.number for row in asvs_rows() if not row.test and row.gap in ("", "—")] == []
