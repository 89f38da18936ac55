"""Each rule of a split is broken alone; proposals keep them or name what they cannot; sums add up."""

from dataclasses import replace
from itertools import pairwise, product
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.splits.composition import CatalogueEntry, composition_of, duration_ns, path_length_m, sums_of
from stone.splits.model import SolverLimits
from stone.splits.proposal import propose
from stone.splits.rules import (
    check_exposed,
    check_length,
    check_light,
    check_places,
    check_regions,
    check_said,
    check_sizes,
    check_split,
    check_whole,
)
from stone.splits.splits import (
    EXPOSED,
    LENGTH,
    LIGHT,
    REGIONS,
    SEPARATED_PLACES,
    SIZES,
    UNSAID,
    WHOLE,
    RuleFinding,
    Split,
)
from stone.splits.surroundings import (
    DAYLIGHT,
    ENVIRONMENTS,
    OFFERED,
    checked_environment,
    checked_illumination,
    checked_region,
)
from testing.refusals import refused_as
from tests.stone.catalogues import catalogue, entry, shuffled


def split_of(*parts: tuple[CatalogueEntry, ...]) -> Split:
    return Split(*(tuple(entry.id for entry in part) for part in parts))


def everywhere() -> tuple[tuple[CatalogueEntry, ...], ...]:
    """Three parts of eight: every environment by day and by night, each in a region of its own."""
    said = [(place, light) for place in ENVIRONMENTS for light in ("day", "night")]
    return tuple(
        tuple(entry(100 * p + i, environment=a, illumination=b) for i, (a, b) in enumerate(said)) for p in range(3)
    )


def only(findings: tuple[RuleFinding, ...]) -> RuleFinding:
    (finding,) = findings
    return finding


def test_a_split_that_keeps_every_rule_has_no_findings() -> None:
    parts = everywhere()
    assert check_split(split_of(*parts), sum(parts, ()), (8, 8, 8)) == ()


@pytest.mark.parametrize("same", [{"name": "Run-02"}, {"recordings": ("ab", "cd")}])
def test_a_sequence_twice_is_found_even_within_one_split_and_so_is_one_that_nobody_has(same: dict[str, object]) -> None:
    a, b = entry(1, **same), entry(2, recordings=("cd",))
    for split, wrong in (
        (split_of((a, b)), (a.id, b.id)),
        (split_of((a,), (), (a,)), (a.id,)),
        (Split(("x",)), ("x",)),
    ):
        finding = only(check_whole(split, (a, b)))
        assert (finding.code, finding.severity, finding.sequences) == (WHOLE, "error", wrong)
    assert check_whole(split_of((a,)), (a, b)) == ()


def test_labels_that_anybody_may_have_are_told_of_in_test_and_nowhere_else() -> None:
    a, b, c = (entry(number, exposure="it is public") for number in (1, 2, 3))
    finding = only(check_exposed(split_of((a,), (b,), (c, entry(4))), (a, b, c, entry(4))))
    assert (finding.code, finding.severity, finding.sequences) == (EXPOSED, "warning", (c.id,))


@pytest.mark.parametrize(("duration_s", "is_found"), [(20.0, False), (19.99, True), (0.0, True)])
def test_a_sequence_below_twenty_seconds_is_found(duration_s: float, is_found: bool) -> None:
    a = entry(1, duration_s=duration_s)
    findings = check_length(split_of((), (a,)), (a,))
    assert [(f.code, f.severity, f.sequences) for f in findings] == [(LENGTH, "error", (a.id,))] * is_found


@pytest.mark.parametrize(
    ("in_train", "in_test", "is_found"),
    [
        ("a", "b", False),
        ("a", "A", True),
        ("", "", True),
        ("lake-1", "Lake_1", True),
        ("Lake1", " lake 1", True),
        ("lake-1", "lake-11", False),
        ("lake.1", "lake1", False),
    ],
)
def test_a_region_in_train_and_test_is_found(in_train: str, in_test: str, is_found: bool) -> None:
    a, b = entry(1, region=in_train), entry(2, region=in_test)
    findings = check_regions(split_of((a,), (), (b,)), (a, b))
    assert [(f.code, f.severity, f.sequences) for f in findings] == [(REGIONS, "error", (a.id, b.id))] * is_found


def test_val_may_share_its_regions_with_both() -> None:
    a, b, c, d = (entry(number, region=region) for number, region in enumerate("ABAB"))
    assert check_regions(split_of((a,), (c, d), (b,)), (a, b, c, d)) == ()


def test_a_split_without_night_is_found_where_there_are_nights_enough() -> None:
    parts = everywhere()
    lit = tuple(replace(one, illumination="dusk") for one in parts[1])
    spare = tuple(entry(900 + i, illumination="moonlit") for i in range(3))
    finding = only(check_light(split_of(parts[0], lit, parts[2]), (*parts[0], *lit, *parts[2], *spare)))
    assert (finding.code, finding.severity) == (LIGHT, "error")
    assert finding.message == "no night sequence in val, although 11 sequences have it"


def test_a_split_without_an_environment_is_found_where_there_is_enough_of_it() -> None:
    parts = everywhere()
    dry = tuple(one for one in parts[2] if one.environment != "lake")
    finding = only(check_places(split_of(parts[0], parts[1], dry), sum(parts, ())))
    assert (finding.code, finding.severity) == (SEPARATED_PLACES, "error")
    assert finding.message.startswith("no lake sequence in test")


@pytest.mark.parametrize(
    ("nights", "obstacle"),
    [
        ((), "0 sequence"),
        (({}, {}), "2 sequence"),
        (({}, {}, {"duration_s": 19.0}), "2 sequence"),
        (({"region": "A"}, {"region": "a"}, {"region": "A"}), "one region"),
    ],
)
def test_what_the_data_do_not_allow_is_a_warning_that_says_why(
    nights: tuple[dict[str, object], ...], obstacle: str
) -> None:
    days = tuple(entry(number) for number in range(3))
    dark = tuple(entry(10 + number, illumination="night", **facts) for number, facts in enumerate(nights))
    finding = only(check_light(split_of((days[0], *dark), (days[1],), (days[2],)), (*days, *dark)))
    assert (finding.code, finding.severity) == (LIGHT, "warning")
    assert obstacle in finding.message


def test_an_empty_split_asks_for_nothing() -> None:
    a, b = entry(1), entry(2, illumination="night")
    findings = check_split(split_of((a, b)), (a, b))
    assert [finding.code for finding in findings if finding.severity == "error"] == []


def test_a_split_of_another_size_is_found() -> None:
    a, b = entry(1), entry(2)
    findings = check_sizes(split_of((a,), (), (b,)), (1, 1, 1))
    assert [(f.code, f.severity, f.message) for f in findings] == [(SIZES, "error", "val has 0 sequences; expected 1")]


def test_what_was_not_said_is_warned_of() -> None:
    a = entry(1, environment="", illumination="", region="")
    findings = check_said(split_of((a,)), (a,))
    assert [(f.code, f.severity, f.sequences) for f in findings] == [(UNSAID, "warning", (a.id,))] * 3


@given(st.integers(0, 99), st.lists(st.integers(0, 3), min_size=12, max_size=12))
def test_leaving_sequences_out_of_the_catalogue_never_makes_a_rule_stricter(seed: int, of: list[int]) -> None:
    """Where the data allow less, what was an error may become a warning, never the other way round."""
    entries = catalogue(12, seed, regions=4)
    parts = tuple(tuple(one for one, part in zip(entries, of, strict=True) if part == p) for p in range(3))
    split = split_of(*parts)
    among_all = {f.message.split(",")[0] for f in check_split(split, entries) if f.severity == "error"}
    among_assigned = check_split(split, sum(parts, ()))
    assert {f.message.split(",")[0] for f in among_assigned if f.severity == "error"} <= among_all


def test_every_illumination_is_day_or_night() -> None:
    assert set(DAYLIGHT.values()) == {"day", "night"}


PAPER = (31, 7, 5)
QUICK = SolverLimits(likeness_nodes=5)


@pytest.mark.whole
def test_43_sequences_are_split_31_7_5_by_every_rule_in_whatever_order_they_come() -> None:
    entries = catalogue(43, 1)
    proposal = propose(entries, PAPER, QUICK)
    assert proposal.is_feasible
    assert proposal.split.sizes == PAPER
    assert check_split(proposal.split, entries, PAPER) == proposal.findings == ()
    assert sorted(one for ids in proposal.split.parts.values() for one in ids) == sorted(e.id for e in entries)
    assert propose(shuffled(entries, 0), PAPER, QUICK) == proposal


def unlikeness(entries: tuple[CatalogueEntry, ...], parts: list[tuple[str, ...]]) -> float:
    """How far the parts' shares of time and of classes are from those of the whole, all told."""
    whole = sums_of(entries)
    told = 0.0
    for ids in parts:
        sums = sums_of(one for one in entries if one.id in ids)
        told += abs(sums.duration_s * len(entries) / (whole.duration_s * len(ids)) - 1)
        shares, of_whole = sums.class_shares(), whole.class_shares()
        assert shares is not None
        assert of_whole is not None
        told += sum(abs(a - b) for a, b in zip(shares, of_whole, strict=True))
    return told


def test_the_parts_are_more_alike_than_a_hundred_splits_by_lot() -> None:
    """Though the lots need not keep any rule."""
    entries = catalogue(43, 0)
    by_lot = []
    for number in range(100):
        ids = tuple(one.id for one in shuffled(entries, number))
        by_lot.append(unlikeness(entries, [ids[:31], ids[31:38], ids[38:]]))
    assert (
        unlikeness(entries, list(propose(entries, PAPER, SolverLimits(likeness_nodes=20)).split.parts.values()))
        < sorted(by_lot)[0]
    )


def test_what_is_left_over_is_in_no_split() -> None:
    proposal = propose(catalogue(30, 1), (8, 4, 4), QUICK)
    assert proposal.is_feasible
    assert proposal.split.sizes == (8, 4, 4)


def test_one_region_for_all_names_the_regions_and_how_many_lie_there() -> None:
    entries = tuple(entry(number, region="Gyeonggi", environment="lake") for number in range(43))
    proposal = propose(entries, PAPER, QUICK)
    assert not proposal.is_feasible
    assert [finding.code for finding in proposal.conflict] == [REGIONS, SIZES]
    assert "Gyeonggi 43" in proposal.conflict[0].message
    assert "31 + 7 + 5 = 43" in proposal.conflict[1].message
    assert proposal.split.sizes == PAPER, "what is proposed all the same keeps the sizes"
    assert [finding.code for finding in proposal.findings if finding.severity == "error"] == [REGIONS]


def test_a_region_spelled_in_several_ways_is_one_for_proposal_and_composition() -> None:
    """Lake 1, lake_1 and lake-1 hold a third each of 12 sequences; only one split leaves the shore out of train."""
    spellings = ("Lake-1", "lake_1", "lake 1 ", "shore")
    entries = tuple(entry(n, region=spellings[n % 4]) for n in range(16))
    proposal = propose(entries, (8, 4, 4), QUICK)
    regions = {one.id: one.region for one in entries}
    assert proposal.is_feasible
    assert {regions[one] for one in proposal.split.parts["test"]} == {"shore"}
    assert {name: sums.sequences for name, sums in composition_of(entries).regions.items()} == {
        "Lake-1": 12,
        "shore": 4,
    }


def test_nights_in_two_regions_that_hold_too_many_for_test_name_night() -> None:
    """Night is in two regions of 19: whichever is test's, 24 sequences are left for train, and 31 are asked for."""
    nights = tuple(entry(n, region="AB"[n % 2], illumination="night" if n < 6 else "day") for n in range(38))
    days = tuple(entry(40 + n) for n in range(5))
    proposal = propose((*nights, *days), PAPER, QUICK)
    assert {finding.code for finding in proposal.conflict} == {LIGHT, REGIONS, SIZES}
    night = next(finding for finding in proposal.conflict if finding.code == LIGHT)
    assert night.message == "night in each split: 6 sequences have it, in 2 region(s): A 3, B 3"


def test_more_than_there_are_names_the_sizes_alone() -> None:
    proposal = propose(catalogue(20, 3), PAPER, QUICK)
    assert [finding.code for finding in proposal.conflict] == [SIZES]
    assert "20 exist" in proposal.conflict[0].message


def test_too_many_short_sequences_name_the_length() -> None:
    entries = (*catalogue(30, 3), *(entry(100 + n, duration_s=12.0) for n in range(13)))
    proposal = propose(entries, PAPER, QUICK)
    assert [finding.code for finding in proposal.conflict] == [LENGTH, SIZES]
    assert proposal.conflict[0].message.startswith("13 of 43 sequences are shorter than 20 s: run-100")


@pytest.mark.whole
def test_one_recording_under_two_names_is_taken_once() -> None:
    entries = (*catalogue(43, 2), entry(50, recordings=("ab",)), entry(51, recordings=("ab",)))
    assert propose(entries, PAPER, QUICK).is_feasible
    clash = propose(entries, (33, 7, 5), QUICK)
    assert [finding.code for finding in clash.conflict] == [WHOLE, SIZES]
    assert "run-50, run-51" in clash.conflict[0].message


def test_an_environment_that_occurs_once_is_not_asked_of_every_split_and_is_warned_of() -> None:
    entries = tuple(e for e in catalogue(43, 0) if e.environment != "lake")
    entries = (*entries, entry(90, environment="lake"))
    proposal = propose(entries, (20, 6, 5), QUICK)
    assert proposal.is_feasible
    assert [(f.code, f.severity) for f in proposal.findings] == [(SEPARATED_PLACES, "warning")]


@pytest.mark.parametrize("sizes", [(0, 0, 0), (-1, 2, 3), (2001, 0, 0)])
def test_sizes_that_are_none_are_refused(sizes: tuple[int, int, int]) -> None:
    with refused_as("bad_split_sizes"):
        propose(catalogue(3, 0), sizes)


def test_a_catalogue_that_is_empty_or_without_end_is_refused() -> None:
    with refused_as("empty_catalogue"):
        propose((), (1, 0, 0))
    with refused_as("catalogue_too_large"):
        propose([entry(number) for number in range(2001)], PAPER)


def small(seed: int, sequences: int) -> tuple[CatalogueEntry, ...]:
    """Few sequences, two environments, two or three regions, some too short, some twins."""
    random = Random(seed)
    return tuple(
        entry(
            number,
            environment=random.choice(ENVIRONMENTS[:2]),
            illumination=random.choice(("day", "night")),
            region=random.choice(("a", "b", "c")[: random.randint(1, 3)]),
            duration_s=random.choice((10.0, 30.0, 60.0, 90.0)),
            recordings=(random.choice("pqrstuvwxyz"),),
        )
        for number in range(sequences)
    )


def splits_that_pass(entries: tuple[CatalogueEntry, ...], sizes: tuple[int, int, int]) -> bool:
    """Every assignment there is, judged by the checks."""
    for parts in product((-1, 0, 1, 2), repeat=len(entries)):
        if tuple(parts.count(p) for p in range(3)) == sizes:
            ids = (tuple(e.id for e, part in zip(entries, parts, strict=True) if part == p) for p in range(3))
            findings = check_split(Split(*ids), entries, sizes)
            if not any(finding.severity == "error" for finding in findings):
                return True
    return False


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(3, 6), st.tuples(*[st.integers(0, 2)] * 3).filter(any))
def test_a_proposal_is_feasible_exactly_where_some_split_is(
    seed: int, sequences: int, sizes: tuple[int, int, int]
) -> None:
    entries = small(seed, sequences)
    proposal = propose(entries, sizes, QUICK)
    errors = [finding for finding in check_split(proposal.split, entries, sizes) if finding.severity == "error"]
    assert proposal.is_feasible == splits_that_pass(entries, sizes)
    assert proposal.is_feasible == (errors == [])


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10**6), st.integers(8, 16))
def test_what_is_claimed_feasible_passes_the_checks_and_what_is_not_breaks_a_rule(seed: int, sequences: int) -> None:
    entries = catalogue(sequences, seed, regions=2 + seed % 5)
    sizes = (sequences - 6, 3, 3)
    proposal = propose(entries, sizes, QUICK)
    codes = {finding.code for finding in check_split(proposal.split, entries, sizes) if finding.severity == "error"}
    assert proposal.is_feasible == (not codes)


@given(st.integers(0, 10**6), st.integers(0, 20))
def test_every_way_of_dividing_adds_to_the_whole(seed: int, sequences: int) -> None:
    entries = catalogue(sequences, seed)
    composition = composition_of(shuffled(entries, seed))
    for tallies in (composition.environments, composition.illuminations, composition.halves, composition.regions,
                    composition.cells):  # fmt: skip
        for name in ("sequences", "frames", "counted", "measured"):
            assert sum(getattr(t, name) for t in tallies.values()) == getattr(composition.total, name)
        assert tuple(map(sum, zip((0, 0, 0), *(t.voxels for t in tallies.values()), strict=True))) == (
            composition.total.voxels
        )
        assert sum(t.duration_s for t in tallies.values()) == pytest.approx(composition.total.duration_s)
    assert composition == composition_of(entries)


def test_what_is_not_known_is_not_added() -> None:
    tally = sums_of([entry(1), entry(2, voxels=None, distance_m=None)])
    assert (tally.sequences, tally.counted, tally.measured) == (2, 1, 1)
    assert (tally.voxels, tally.distance_m) == ((100, 200, 700), 120.0)
    assert tally.class_shares() == (0.1, 0.2, 0.7)
    assert sums_of([]).class_shares() is None


def test_keys_come_in_the_order_of_the_words_and_what_was_not_said_last() -> None:
    entries = [entry(n, environment=word) for n, word in enumerate(["", "moon", "lake", "farmland"])]
    assert list(composition_of(entries).environments) == ["farmland", "lake", "moon", ""]


def test_a_sequence_lasts_as_long_as_its_frames_stand_for() -> None:
    stamps = 1_777_800_000_000_000_000 + 10**8 * np.arange(200)
    assert duration_ns(stamps) == 20 * 10**9, "200 frames at 10 Hz are 20 s, not 19.9"


@given(st.integers(0, 6), st.floats(-3.0, 3.0))
def test_the_way_is_as_long_however_the_world_is_turned(points: int, yaw: float) -> None:
    positions = np.random.default_rng(points).normal(size=(points, 3))
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    slowly = sum(float(np.linalg.norm(b - a)) for a, b in pairwise(positions))
    assert path_length_m(positions @ turn.T + 5.0) == pytest.approx(slowly)


@pytest.mark.parametrize(
    ("check", "word", "refusal"),
    [
        (checked_environment, "Forest", "unknown_environment"),
        (checked_environment, "a forest", "unknown_environment"),
        (checked_environment, "x" * 33, "unknown_environment"),
        (checked_illumination, "Day", "unknown_illumination"),
        (checked_region, "Gyeong gi", "bad_region"),
        (checked_region, "x" * 65, "bad_region"),
        (checked_region, "../x", "bad_region"),
    ],
)
def test_what_is_no_plain_word_is_refused(check: object, word: str, refusal: str) -> None:
    assert [checked_environment(one) for one in ("", *OFFERED, "rice-paddy")] == ["", *OFFERED, "rice-paddy"]
    assert OFFERED[: len(ENVIRONMENTS)] == ENVIRONMENTS
    with refused_as(refusal):
        check(word)  # type: ignore[operator]
