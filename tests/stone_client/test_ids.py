"""Ids as they are typed: whole, short, or by age; what is ambiguous is refused with its candidates."""

from collections.abc import Iterator
from typing import Any

import pytest

from stone_client.server import sequences
from stone_client.server.ids import chosen_id, whole_id
from testing.refusals import refused_as

IDS = ["01a223216a010001e2ad31397e2abcde", "01a223216a010000aaaaaaaaaaaaaaaa", "02ffffff00000000bbbbbbbbbbbbbbbb"]


@pytest.mark.parametrize(
    ("named", "place"),
    [("02ffff", 2), ("01a223216a010001", 0), ("2abcde", 0), ("latest", 0), ("latest~2", 2)],
)
def test_a_beginning_an_end_or_an_age_names_one(named: str, place: int) -> None:
    assert chosen_id(named, IDS) == IDS[place]


@pytest.mark.parametrize("named", ["02fff", "02FFFF", "ffffff0", "latest~3", "latest~", "", "02ffff*", IDS[0] + "0"])
def test_five_digits_a_middle_and_other_texts_name_none(named: str) -> None:
    assert chosen_id(named, IDS) is None


def test_an_ambiguous_short_id_is_refused_with_its_candidates() -> None:
    with refused_as("ambiguous_id", match=f"2 ids; give more digits: {IDS[1]}, {IDS[0]}"):
        whole_id("01a223", IDS)


class Listed:
    """An API of a few sequences and jobs."""

    def __init__(self, **items: list[dict[str, Any]]) -> None:
        self.items = items

    def pages(self, path: str, name: str | None = None) -> Iterator[dict[str, Any]]:
        return (one for one in self.items[path.strip("/")] if name is None or one["name"] == name)

    def read(self, path: str) -> dict[str, Any]:
        _, kind, item_id = path.split("/")
        return next(one for one in self.items[kind] if one["id"] == item_id)


def test_a_sequences_name_comes_before_a_short_id() -> None:
    api = Listed(sequences=[{"id": IDS[0], "name": "02ffff"}, {"id": IDS[2], "name": "lake"}], jobs=[])
    assert sequences.find_sequence(api, "02ffff")["id"] == IDS[0]  # type: ignore[arg-type]
    assert sequences.find_sequence(api, "02ffffff")["id"] == IDS[2]  # type: ignore[arg-type]


def test_a_short_id_of_a_job_and_of_a_sequence_is_ambiguous() -> None:
    api = Listed(sequences=[{"id": IDS[0], "name": "lake"}], jobs=[{"id": IDS[1], "state": "queued"}])
    assert sequences.find_subject(api, "aaaaaa") == ("job", {"id": IDS[1], "state": "queued"})  # type: ignore[arg-type]
    with refused_as("ambiguous_id"):
        sequences.find_subject(api, "01a223216a01")  # type: ignore[arg-type]
    with refused_as("not_found"):
        sequences.find_subject(api, "abcdef")  # type: ignore[arg-type]
