"""Label sets and their comparisons over HTTP: counted once by a job, shown to their owner alone."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import httpx
import numpy as np
import pytest
import zstandard
from sqlalchemy import select

from services.runtime.orm import AuditEntry, Job, LabelComparison, LabelledFrameRow, LabelSet, new_id
from services.runtime.platform import Platform
from stone_files.npz import npz_bytes
from testing.api.serving import Person
from testing.worlds.benchmark_world import run_eval
from testing.worlds.made import NOBODY, labels, sequence

URL = "/api/v1/sequences"
SHAPE = (256, 256, 32)
T, N = 1, 3


@dataclass(frozen=True)
class Compared:
    """A sequence with two label sets of three frames, in the first of which one voxel differs."""

    sequence: Mapping[str, Any]
    a_id: str
    b_id: str
    tokens: tuple[str, ...]

    @property
    def url(self) -> str:
        return f"{URL}/{self.sequence['id']}/label-comparisons"

    def ids(self) -> dict[str, str]:
        return {"a_id": self.a_id, "b_id": self.b_id}


def label_file(kind: int) -> bytes:
    """Two voxels of class T near the robot, and one of this class farther than 20 m."""
    grid, seen = (np.zeros(SHAPE, np.uint8) for _ in range(2))
    grid[128, 128, 9:11], grid[250, 128, 9], seen[128, 128] = T, kind, 1
    return npz_bytes({"semantics": grid, "mask_lidar": seen, "mask_camera": seen})


@pytest.fixture
def forest(api: httpx.Client, platform: Platform, curator: Person) -> Compared:
    made = sequence(api, curator)
    b = labels(platform, made, contents=[label_file(N), label_file(T), label_file(T)], seed=b"b")
    a = labels(platform, made, contents=[label_file(T)] * 3, seed=b"a")
    return Compared(made, a.id, b.id, tuple(a.frames))


def ask(api: httpx.Client, caller: Person, forest: Compared, **ids: str) -> httpx.Response:
    return api.post(forest.url, json=forest.ids() | ids, headers=caller.headers)


def test_the_label_sets_of_a_sequence_are_listed_newest_first_and_one_counts(
    api: httpx.Client, curator: Person, forest: Compared
) -> None:
    listed = api.get(f"{URL}/{forest.sequence['id']}/label-sets", headers=curator.headers).json()
    assert [(one["id"], one["is_counting"], one["profile"], one["frames"]) for one in listed["items"]] == [
        (forest.a_id, True, "paper", 3),
        (forest.b_id, False, "paper", 3),
    ]


def test_a_frame_of_each_label_set_has_its_voxels_by_the_token_of_either(
    api: httpx.Client, curator: Person, participant: Person, forest: Compared
) -> None:
    """The planes of the classes, decoded by hand; only to the owner, and only what is there."""
    place = np.ravel_multi_index((250, 128, 9), SHAPE)
    of_sets = f"{URL}/{forest.sequence['id']}/label-sets"
    for label_set_id, kind in ((forest.a_id, T), (forest.b_id, N)):
        path = f"{of_sets}/{label_set_id}/frames/{forest.tokens[0]}/voxels"
        answer = api.get(path, headers=curator.headers)
        planes = zstandard.ZstdDecompressor().decompress(answer.content)[8:]
        bits = np.unpackbits(np.frombuffer(planes, np.uint8), bitorder="little").reshape(3, -1)
        assert bits[:, place].tolist() == [kind & 1, kind >> 1, 0]
        assert bits.sum() == 2 + bin(kind).count("1") + 32
        assert "immutable" in answer.headers["cache-control"]
        assert api.get(path, headers=participant.headers).status_code == 404
        assert api.get(path).status_code == 401
    for label_set_id, token in ((forest.a_id, "0" * 32), (NOBODY, forest.tokens[0])):
        answer = api.get(f"{of_sets}/{label_set_id}/frames/{token}/voxels", headers=curator.headers)
        assert answer.status_code == 404


def test_each_label_set_says_how_well_it_holds_or_that_it_is_unknown(
    api: httpx.Client, platform: Platform, curator: Person, forest: Compared
) -> None:
    with platform.database.transaction() as session:
        row = session.get_one(LabelSet, forest.b_id)
        row.held_out_recall = row.held_out_m = row.gravest_code = row.gravest_severity = None
    listed = api.get(f"{URL}/{forest.sequence['id']}/label-sets", headers=curator.headers).json()["items"]
    shown = [{key: one[key] for key in ("held_out_recall", "held_out_m", "gravest")} for one in listed]
    assert shown[0] == {"held_out_recall": 0.9731, "held_out_m": 75.4, "gravest": {"code": "LAB-605", "harm": "wrong"}}
    assert set(shown[1].values()) == {None}
    labels = api.get(f"{URL}/{forest.sequence['id']}", headers=curator.headers).json()["labels"]
    assert shown[0].items() <= labels.items()


def test_a_comparison_is_counted_once_and_says_what_differs(
    api: httpx.Client, platform: Platform, curator: Person, forest: Compared
) -> None:
    first, second = (ask(api, curator, forest) for _ in range(2))
    assert (first.status_code, first.json()) == (202, second.json())
    assert first.json()["job"]["kind"] == "eval.compare"
    assert api.get(first.headers["Location"], headers=curator.headers).json()["record"] is None
    run_eval(platform)
    shown = api.get(first.headers["Location"], headers=curator.headers).json()
    assert (shown["state"], shown["failure"]) == ("succeeded", None)
    record = shown["record"]
    assert (record["frames"], record["only_in_a"], record["has_equal_classes"]) == (3, 0, False)
    assert record["all_voxels"]["agreement_ratio"] == pytest.approx(8 / 9)
    assert record["all_voxels"]["confusion"][T] == [0, 8, 0, 1]
    assert [ring["agreement_ratio"] for ring in record["all_voxels"]["rings"]] == [1.0, None, pytest.approx(2 / 3)]
    assert record["seen_in_both"]["ratios"]["iou_t"] == 1.0
    assert record["seen_voxels"] == {"both": 96, "only_a": 0, "only_b": 0}
    assert record["least_alike"] == [{"token": forest.tokens[0], "agreement_ratio": pytest.approx(2 / 3)}]
    assert ask(api, curator, forest).json()["comparison"] == shown
    assert api.get(forest.url, headers=curator.headers).json()["items"] == [shown]


def test_frames_are_those_of_equal_stamps_in_whole_microseconds(
    api: httpx.Client, platform: Platform, curator: Person, forest: Compared
) -> None:
    """A published label set has no nanoseconds; its frames have tokens of their own."""
    change_stamps(platform, forest.b_id, lambda ordinal: 999 if ordinal < 2 else 1000)
    made = ask(api, curator, forest).json()["comparison"]["id"]
    run_eval(platform)
    record = api.get(f"{forest.url}/{made}", headers=curator.headers).json()["record"]
    assert (record["frames"], record["only_in_a"], record["only_in_b"]) == (2, 1, 1)
    with platform.database.reading() as session:
        in_b = select(LabelledFrameRow.token).where(LabelledFrameRow.label_set_id == forest.b_id)
        theirs = session.scalars(in_b.order_by(LabelledFrameRow.ordinal)).all()
    for token, status in (
        *zip(forest.tokens, (200, 200, 404), strict=True),
        *zip(theirs, (200, 200, 404), strict=True),
    ):
        for shown in (f"{token}.png", f"{token}/voxels"):
            assert api.get(f"{forest.url}/{made}/frames/{shown}", headers=curator.headers).status_code == status


def change_stamps(platform: Platform, label_set_id: str, later_ns: Callable[[int], int]) -> None:
    """Give the frames of a label set other tokens, and stamps that are so much later."""
    frames = select(LabelledFrameRow).where(LabelledFrameRow.label_set_id == label_set_id)
    with platform.database.transaction() as session:
        for row in session.scalars(frames):
            row.stamp_ns, row.token = row.stamp_ns + later_ns(row.ordinal), new_id()


def test_what_cannot_be_compared_is_refused_with_its_reason(
    api: httpx.Client, platform: Platform, curator: Person, forest: Compared
) -> None:
    same = ask(api, curator, forest, b_id=forest.a_id)
    assert (same.status_code, same.json()["code"]) == (422, "same_label_set")
    foreign = labels(platform, sequence(api, curator, "another"), contents=[label_file(T)])
    for unknown in (foreign.id, NOBODY):
        refused = ask(api, curator, forest, b_id=unknown)
        assert (refused.status_code, refused.json()["code"]) == (422, "unknown_label_set")


def test_comparisons_go_with_their_label_sets_and_are_in_the_audit_log(
    api: httpx.Client, platform: Platform, curator: Person, forest: Compared
) -> None:
    made = ask(api, curator, forest).json()["comparison"]["id"]
    with platform.database.transaction() as session:
        entry = session.scalars(select(AuditEntry).where(AuditEntry.act == "label_comparison.create")).one()
        assert entry.subject_id == made
        session.delete(session.get_one(LabelSet, forest.b_id))
        session.flush()
        assert session.get(LabelComparison, made, populate_existing=True) is None
    run_eval(platform)
    with platform.database.reading() as session:
        assert [job.state for job in session.scalars(select(Job).where(Job.kind == "eval.compare"))] == ["cancelled"]
