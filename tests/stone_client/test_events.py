"""Server-sent events are read as the HTML standard says."""

import pytest

from stone_client.server.job_following import Event, events


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("data: one\n\n", [Event("message", "", "one")]),
        ("event: job\nid: 7\ndata: {}\n\n", [Event("job", "7", "{}")]),
        ("data: one\ndata: two\n\n", [Event("message", "", "one\ntwo")]),
        ("data:  two spaces\n\n", [Event("message", "", " two spaces")]),
        (": still here\n\ndata:x\n\n", [Event("message", "", "x")]),
        ("event: empty\n\ndata: x\n\n", [Event("message", "", "x")]),
        ("id: 7\ndata: a\n\ndata: b\n\n", [Event("message", "7", "a"), Event("message", "7", "b")]),
        ("retry: 10\ndata\ndata: x\n\n", [Event("message", "", "\nx")]),
        ("data: cut off", []),
    ],
)
def test_fields_make_events(text: str, expected: list[Event]) -> None:
    assert list(events(text.splitlines())) == expected
