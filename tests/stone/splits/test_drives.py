"""Sequences that continue each other are one drive, whatever they are called; a split that tears one is refused."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone.splits.composition import CatalogueEntry, sums_of
from stone.splits.drives import DrivenTrack, TrackOrigin, continues, driven_track, drives_of, gap_between
from stone.splits.model import SolverLimits
from stone.splits.proposal import propose
from stone.splits.rules import check_drives, check_length, check_light, check_split
from stone.splits.splits import DRIVES, LIGHT, SIZES, Split
from tests.stone.catalogues import entry

FIRST_NS, PERIOD_NS, SPEED_M_S = 1_755_846_856_000_000_000, 100_000_000, 1.2
FARM = TrackOrigin("siheung_farmland", "n001", "dataset:siheung")
FRAMES = 1781  # of the released farmland bag: 8 scenes of 200 frames and one of 181


def drive(frames: int, origin: TrackOrigin = FARM, start_s: float = 0.0, start_m: float = 0.0) -> list[DrivenTrack]:
    """Chunks of 200 frames of a robot that goes round a wide curve."""
    stamps_ns = FIRST_NS + int(start_s * 1e9) + PERIOD_NS * np.arange(frames)
    angle = SPEED_M_S * 0.1 * np.arange(frames) / 300.0
    positions = np.column_stack([300 * np.sin(angle) + start_m, 300 * (1 - np.cos(angle)), 0.01 * np.arange(frames)])
    cuts = [slice(first, first + 200) for first in range(0, frames, 200)]
    tracks = [driven_track(stamps_ns[cut], positions[cut], origin) for cut in cuts]
    return [track for track in tracks if track is not None]


def named(*drives: list[DrivenTrack]) -> dict[str, DrivenTrack]:
    return {
        f"{letter}-{n}": track for letter, tracks in zip("abcd", drives, strict=False) for n, track in enumerate(tracks)
    }


def test_chunks_of_one_bag_are_one_drive_and_those_of_another_day_place_vehicle_or_log_are_not() -> None:
    a, b = drive(FRAMES), drive(603, start_s=86_400)
    c = drive(400, replace(FARM, vehicle="n002"), start_s=FRAMES * 0.1)
    d = drive(400, start_s=FRAMES * 0.1, start_m=5.0)  # it would have to jump
    tracks = named(a, b, c, d)
    found = set(drives_of(tracks).values())
    assert {len(one) for one in found if one[0].startswith("a")} == {9}
    assert sorted("".join(sorted({name[0] for name in one})) for one in found) == ["a", "b", "c", "d"]
    assert drives_of(tracks)["a-8"] == tuple(f"a-{n}" for n in range(9)), "in time order"
    assert drives_of(dict(reversed(tracks.items()))) == drives_of(tracks)


@pytest.mark.parametrize(
    ("change", "is_one"),
    [
        ({}, True),
        ({"log": "", "vehicle": ""}, True),
        ({"log": "another"}, False),
        ({"vehicle": "n002"}, False),
        ({"map": "dataset:suwon"}, False),
    ],
)
def test_what_is_stated_may_contradict_and_what_is_not_does_not(change: dict[str, str], is_one: bool) -> None:
    first, second = drive(400)
    assert continues(first, replace(second, **change)) is is_one
    assert not continues(replace(second, **change), first)


@pytest.mark.parametrize(
    ("gap_s", "ahead_m", "is_one"), [(0.1, 0.0, True), (9.0, 10.0, True), (9.0, 25.0, False), (11.0, 0.0, False)]
)
def test_a_short_gap_is_one_that_the_robot_can_have_driven(gap_s: float, ahead_m: float, is_one: bool) -> None:
    stamps_ns = FIRST_NS + PERIOD_NS * np.arange(200)
    line = np.column_stack([0.12 * np.arange(200), np.zeros(200), np.zeros(200)])
    first = driven_track(stamps_ns, line, FARM)
    second = driven_track(stamps_ns + 19_900_000_000 + int(gap_s * 1e9), line + line[-1] + [ahead_m, 0, 0], FARM)
    assert first is not None
    assert second is not None
    assert continues(first, second) is is_one


def test_sequences_that_overlap_in_time_are_one_drive_if_they_overlap_in_place_too() -> None:
    stamps_ns, line = FIRST_NS + PERIOD_NS * np.arange(400), np.outer(0.12 * np.arange(400), [1.0, 0, 0])
    first = driven_track(stamps_ns[:250], line[:250], FARM)
    for aside_m, is_one in ((0.0, True), (8.0, False)):
        second = driven_track(stamps_ns[150:], line[150:] + np.array([0, aside_m, 0]), FARM)
        assert first is not None
        assert second is not None
        assert continues(first, second) is is_one


def test_recordings_whose_odometry_begins_anew_are_one_drive_if_they_follow_within_a_period() -> None:
    """Our own: chunks of one vehicle, each in a map of its own."""
    own = TrackOrigin(vehicle="husky-3")
    (first,), (anew,), (later,) = (drive(200, own, start_s=at) for at in (0.0, 20.0, 23.0))
    assert continues(first, anew)
    assert not continues(first, later)
    assert not continues(replace(first, vehicle=""), replace(anew, vehicle="")), "no vehicle is named"
    assert not continues(first, replace(anew, first_ns=first.first_ns + 10**9)), "two robots of one name"


@given(st.lists(st.integers(0, 60), min_size=1, max_size=25), st.randoms(use_true_random=False))
def test_drives_are_the_runs_that_gaps_leave_in_whatever_order_they_come(gaps: list[int], random: object) -> None:
    """Of sequences at one place, one after another: a gap of more than 10 s ends a drive."""
    tracks, at_s = {}, 0.0
    for number, gap_s in enumerate(gaps):
        at_s += 20.0 + gap_s
        begin_ns = FIRST_NS + int(at_s * 1e9)
        still = ((0.0, 1.0, 2.0, 3.0), (20.0, 1.0, 2.0, 3.0))
        tracks[f"{number:02}"] = DrivenTrack("", "n1", "m", begin_ns, begin_ns + 20 * 10**9, PERIOD_NS, 0.5, still)
    wanted, names = [["00"]], sorted(tracks)
    for name, gap_s in zip(names[1:], gaps[1:], strict=True):
        if gap_s > 10:
            wanted.append([])
        wanted[-1].append(name)
    random.shuffle(names)  # type: ignore[attr-defined]
    found = drives_of({name: tracks[name] for name in names})
    assert sorted(set(found.values())) == [tuple(run) for run in wanted]


def test_the_gap_is_the_least_distance_and_time_over_all_pairs() -> None:
    train, test = named(drive(FRAMES)), named(drive(603, start_s=7200.0, start_m=-400.0))
    gap = gap_between(train, test)
    points = [np.array([place[1:] for of in group.values() for place in of.places]) for group in (train, test)]
    dense = min(float(np.linalg.norm(a - b)) for a, b in product(*points))
    assert gap.distance_m is not None
    assert gap.distance_m == pytest.approx(dense, abs=2.0)
    assert gap.time_s == pytest.approx(7200.0 - 0.1 * (FRAMES - 1))
    assert gap.soonest == ("a-8", "a-0")
    apart = {name: replace(track, map="elsewhere") for name, track in test.items()}
    assert (gap_between(train, apart).distance_m, gap_between(train, apart).time_s) == (None, gap.time_s)
    assert gap_between({"x": None, **train}, {"y": None}).unknown == 2


def chunks(name: str, count: int, first: int, **said: object) -> tuple[CatalogueEntry, ...]:
    return tuple(
        entry(first + n, drive=name, drive_s=18.1 * count, duration_s=18.1, region=name, **said) for n in range(count)
    )


def test_a_torn_drive_is_an_error_that_names_it_and_the_splits_and_a_part_of_one_is_none() -> None:
    a, alone = chunks("farm", 4, 0), entry(9)
    ids = [one.id for one in a]
    (finding,) = check_drives(Split((*ids[:2], alone.id), (), tuple(ids[2:])), (*a, alone))
    assert (finding.code, finding.severity, set(finding.sequences)) == (DRIVES, "error", set(ids))
    assert "drive 'farm' is divided" in finding.message
    assert "2 in train (run-00, run-01) and 2 in test (run-02, run-03)" in finding.message
    for split in (Split(tuple(ids)), Split((ids[0],), (alone.id,)), Split((ids[0], ids[3]))):
        assert check_drives(split, (*a, alone)) == ()


def test_chunks_are_as_long_as_their_drive_and_night_in_one_drive_is_not_in_three_splits() -> None:
    nights, days = chunks("night", 6, 0, illumination="night"), tuple(entry(20 + n) for n in range(3))
    assert check_length(Split(tuple(one.id for one in nights)), nights) == ()
    assert len(check_length(Split((nights[0].id,)), (replace(nights[0], drive_s=0.0),))) == 1
    split = Split((*(one.id for one in nights), days[0].id), (days[1].id,), (days[2].id,))
    (finding,) = check_light(split, (*nights, *days))
    assert (finding.code, finding.severity) == (LIGHT, "warning")
    assert "6 sequences of 1 drive" in finding.message
    assert sums_of((*nights, *days)).drives == 4


def test_a_proposal_keeps_drives_whole_and_names_them_if_the_sizes_would_tear_one() -> None:
    entries = tuple(one for n in range(4) for one in chunks(f"drive-{n}", 5, 10 * n))
    quick = SolverLimits(likeness_nodes=5)
    fits = propose(entries, (10, 5, 5), quick)
    assert fits.is_feasible
    assert check_split(fits.split, entries, (10, 5, 5)) == fits.findings
    torn = propose(entries, (12, 4, 4), quick)
    assert {DRIVES, SIZES} <= {finding.code for finding in torn.conflict}
    assert "drive-0 5" in next(finding.message for finding in torn.conflict if finding.code == DRIVES)
    assert check_drives(torn.split, entries) == (), "sizes give way, never a drive"
