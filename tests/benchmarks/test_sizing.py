"""Costs are told for any size by a line through two, and what a platform holds is counted by what it is."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from sqlalchemy import func, select

from benchmarks.sizing.costs import MeasuredCosts, line_through
from benchmarks.sizing.holdings import MB, bytes_below, holdings_of
from services.runtime.orm import Blob
from services.runtime.platform import Platform
from testing.api.serving import Person, client_of, person
from testing.worlds import made


@pytest.fixture
def curator(platform: Platform) -> Person:
    return person(platform, "curator")


@pytest.fixture
def api(platform: Platform) -> Iterator[httpx.Client]:
    with client_of(platform) as client:
        yield client


def test_a_line_gives_its_two_sizes_again_and_any_other() -> None:
    line = line_through(MeasuredCosts(100, {"CPU s": 7.0}), MeasuredCosts(300, {"CPU s": 11.0}))
    assert line.of(100) == {"CPU s": 7.0}
    assert line.of(300) == {"CPU s": 11.0}
    assert line.of(1000, things=2) == {"CPU s": 2 * 5.0 + 1000 * 0.02}


def test_nothing_costs_less_than_nothing_once() -> None:
    line = line_through(MeasuredCosts(100, {"rows": 1.0}), MeasuredCosts(200, {"rows": 3.0, "kept": 4.0}))
    assert line.once == {"rows": 0.0, "kept": 0.0}
    assert line.each_frame == {"rows": 0.02, "kept": 0.04}


def test_one_size_gives_no_line() -> None:
    with pytest.raises(ValueError, match="not more than 100"):
        line_through(MeasuredCosts(100, {}), MeasuredCosts(100, {}))


def test_what_labels_and_an_export_add_is_counted_by_what_it_is(
    platform: Platform, api: httpx.Client, curator: Person
) -> None:
    sequence = made.sequence(api, curator)
    before = holdings_of(platform)
    labels = made.labels(platform, sequence)
    made.export(platform, sequence["id"], {"map.ply": b"ply" * 1000})
    after = holdings_of(platform)
    costs = after.costs_since(before)
    assert costs["labels, MB"] == sum(map(len, labels.frames.values())) / MB
    assert 3000 <= costs["mesh, MB"] * MB < 3500  # its packs say where each file begins
    assert after.rows["labelled_frames"] - before.rows["labelled_frames"] == len(labels.frames)
    with platform.database.reading() as session:
        stored = session.scalar(select(func.sum(Blob.size_bytes)))
    assert sum(after.stored_bytes.values()) == stored


def test_files_that_go_while_they_are_counted_count_nothing(tmp_path: Path) -> None:
    (tmp_path / "kept").write_bytes(b"\x01" * 100_000)
    (tmp_path / "gone").symlink_to(tmp_path / "nothing")
    assert 100_000 <= bytes_below(tmp_path) < 200_000
