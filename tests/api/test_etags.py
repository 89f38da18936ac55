"""A change says which state it means; a reader who has it is not sent it again."""

import pytest
from fastapi import Request

from api.errors import PreconditionFailedError, PreconditionRequiredError
from api.etags import etag, is_unchanged, require_match


def request(**headers: str) -> Request:
    raw = [(name.replace("_", "-").encode(), value.encode("latin-1")) for name, value in headers.items()]
    return Request({"type": "http", "method": "GET", "path": "/", "headers": raw})


def test_a_change_that_says_nothing_is_428() -> None:
    with pytest.raises(PreconditionRequiredError):
        require_match(request(), 7)


@pytest.mark.parametrize("given", ["", '"6"', "7", 'W/"7"', '"77"', '"7', '"', '"6", "8"', "x" * 100_000, '"7 "'])
def test_a_change_that_means_another_state_is_412(given: str) -> None:
    with pytest.raises(PreconditionFailedError, match='is at "7"'):
        require_match(request(if_match=given), 7)


@pytest.mark.parametrize("given", ['"7"', '"6", "7"', "*", ' "7" '])
def test_a_change_that_means_this_state_passes(given: str) -> None:
    require_match(request(if_match=given), 7)


@pytest.mark.parametrize(("given", "expected"), [
    ('"7"', True), ('W/"7"', True), ('"6", W/"7"', True), ("*", True),
    ("", False), ('"6"', False), ("7", False),
])  # fmt: skip
def test_a_reader_who_has_this_state_is_told_so(given: str, expected: bool) -> None:
    assert is_unchanged(request(if_none_match=given), 7) is expected
    assert not is_unchanged(request(), 7)


def test_a_tag_is_quoted() -> None:
    assert etag(7) == '"7"'
    assert etag("ab") == '"ab"'
