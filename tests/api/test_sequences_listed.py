"""What a list of sequences says of each: what its labels add up to, its part of the splits, in how many statements."""

from dataclasses import replace
from typing import Any

import httpx
import pytest
from sqlalchemy import event, update

from api.deps import VISITOR
from api.views.sequences import sequence_detail, sequence_items, shown_sequence_detail
from services.runtime.database.inserts import insert_new
from services.runtime.orm import LabelSet, SequenceRow, SplitMember
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.worlds.made import labels, sequence

URL = "/api/v1/sequences"


def listed(api: httpx.Client, who: Person) -> dict[str, dict[str, Any]]:
    return {item["name"]: item for item in api.get(URL, headers=who.headers).json()["items"]}


def put_into(platform: Platform, part: str, *ids: str) -> None:
    with platform.database.transaction() as session:
        insert_new(session, SplitMember, [{"sequence_id": one, "part": part} for one in ids])


def test_a_list_says_what_labels_add_up_to(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    labels(platform_on, sequence(api_on, ada, "labelled"))
    sequence(api_on, ada, "bare")
    shown = listed(api_on, ada)
    keys = ("class_voxels", "duration_s", "distance_m", "picture")
    assert [shown["labelled"][key] for key in keys] == [{"t": 100, "p": 200, "n": 700}, 25.0, 30.5, "bev.png"]
    assert [shown["bare"][key] for key in keys] == [None, None, None, None]


def test_labels_of_an_earlier_version_that_did_not_count_are_unknown_not_zero(
    api: httpx.Client, platform: Platform, curator: Person
) -> None:
    made = labels(platform, sequence(api, curator, "old"))
    with platform.database.transaction() as session:
        session.execute(update(LabelSet).where(LabelSet.id == made.id).values(t_voxels=None, duration_ns=None))
    shown = listed(api, curator)["old"]
    assert (shown["class_voxels"], shown["duration_s"], shown["labels"]["id"]) == (None, None, made.id)


def test_the_labels_that_were_asked_for_last_count_though_others_are_newer(
    api_on: httpx.Client, platform_on: Platform
) -> None:
    ada = person(platform_on, "curator")
    made = sequence(api_on, ada, "forest")
    first, _second = labels(platform_on, made, 2, b"a"), labels(platform_on, made, 3, b"b")
    with platform_on.database.transaction() as session:
        session.execute(update(LabelSet).where(LabelSet.id == first.id).values(chosen_ns=now_ns() + 10**9))
    assert listed(api_on, ada)["forest"]["labels"]["frames"] == 2
    assert api_on.get(f"{URL}/{made['id']}", headers=ada.headers).json()["labels"]["id"] == first.id


def test_a_split_is_told_to_the_owner_and_administrators_only(
    api: httpx.Client, platform: Platform, curator: Person, administrator: Person
) -> None:
    made = sequence(api, curator, "forest")
    put_into(platform, "val", made["id"])
    headers = {**curator.headers, "If-Match": "*"}
    assert api.patch(f"{URL}/{made['id']}", json={"is_public": True}, headers=headers).json()["split"] == "val"
    other = person(platform, "curator")
    assert [listed(api, who)["forest"]["split"] for who in (curator, administrator, other)] == ["val", "val", None]
    assert api.get(URL).json()["items"][0]["split"] is None


@pytest.mark.parametrize("count", [1, 7])
def test_sequences_are_two_statements_beside_their_own_however_many_they_are(
    api: httpx.Client, platform: Platform, curator: Person, count: int
) -> None:
    for number in range(count):
        labels(platform, sequence(api, curator, f"forest-{number}"), seed=bytes([number]))
    said: list[str] = []
    with platform.database.reading() as session:
        rows = list(session.query(SequenceRow))
        event.listen(session.get_bind(), "before_cursor_execute", lambda *given: said.append(given[2]))
        owner = VISITOR.__class__(curator.user_id, "", "curator", frozenset({"read"}), is_session=False)
        assert len(sequence_items(session, rows, owner)) == count
    assert len(said) == 2, said


def test_a_sequence_is_said_by_itself_as_in_a_list_and_as_its_pages_say_it(
    api_on: httpx.Client, platform_on: Platform
) -> None:
    """To its owner and, as it is public, to another; with labels and without."""
    ada, other = person(platform_on, "curator"), person(platform_on, "curator")
    made = [sequence(api_on, ada, name) for name in ("labelled", "bare")]
    labels(platform_on, made[0])
    put_into(platform_on, "val", *(one["id"] for one in made))
    with platform_on.database.transaction() as session:
        session.execute(update(SequenceRow).values(is_public=True))
    for who, split in ((ada, "val"), (other, None)):
        for one in made:
            said = api_on.get(f"{URL}/{one['id']}", headers=who.headers).json()
            assert listed(api_on, who)[one["name"]].items() <= said.items()
            caller = replace(VISITOR, user_id=who.user_id, role="curator")
            with platform_on.database.reading() as session:
                detail = sequence_detail(session, session.get_one(SequenceRow, one["id"]), caller)
            assert (said, said["split"]) == (detail.model_dump(mode="json"), split)


def test_a_sequence_is_read_by_two_statements_and_its_labels_by_three_more(
    api_on: httpx.Client, platform_on: Platform
) -> None:
    """Of somebody else's; to its owner it is said too which recordings were added later."""
    ada, other = person(platform_on, "curator"), person(platform_on, "curator")
    made = [sequence(api_on, ada, name) for name in ("bare", "labelled")]
    labels(platform_on, made[1])
    with platform_on.database.transaction() as session:
        session.execute(update(SequenceRow).values(is_public=True))
    counts, statements = [], list[str]()
    event.listen(platform_on.database.engine, "before_cursor_execute", lambda _c, _k, text, *_: statements.append(text))
    caller = replace(VISITOR, user_id=other.user_id, role="curator")
    for one in made:
        statements.clear()
        with platform_on.database.reading() as session:
            shown_sequence_detail(session, caller, one["id"])
        counts.append(len([text for text in statements if text.lstrip().startswith(("SELECT", "WITH"))]))
    assert counts == [2, 5], statements
