"""Proposals: the paper's split of 43, the rule that fails where it cannot be, and a solver that tries everything."""

from itertools import product
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.splits.composition import CatalogueEntry, sums_of
from stone.splits.model import SolverLimits
from stone.splits.proposal import propose
from stone.splits.rules import check_split
from stone.splits.splits import (
    LENGTH,
    LIGHT,
    REGIONS,
    SEPARATED_PLACES,
    SIZES,
    WHOLE,
    BadSizesError,
    CatalogueTooLargeError,
    EmptyCatalogueError,
    Split,
)
from stone.splits.surroundings import ENVIRONMENTS
from tests.stone.catalogues import catalogue, entry, shuffled

PAPER = (31, 7, 5)
QUICK = SolverLimits(likeness_nodes=5)


@pytest.mark.parametrize("seed", range(2))
def test_43_sequences_are_split_31_7_5_by_every_rule(seed: int) -> None:
    entries = catalogue(43, seed)
    proposal = propose(entries, PAPER, QUICK)
    assert proposal.is_feasible
    assert proposal.split.sizes == PAPER
    assert check_split(proposal.split, entries, PAPER) == proposal.findings == ()
    assert sorted(one for ids in proposal.split.parts.values() for one in ids) == sorted(e.id for e in entries)


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


@pytest.mark.parametrize("seed", range(1))
def test_the_parts_are_more_alike_than_a_hundred_splits_by_lot(seed: int) -> None:
    """Though the lots need not keep any rule."""
    entries = catalogue(43, seed)
    by_lot = []
    for number in range(100):
        ids = tuple(one.id for one in shuffled(entries, number))
        by_lot.append(unlikeness(entries, [ids[:31], ids[31:38], ids[38:]]))
    assert (
        unlikeness(entries, list(propose(entries, PAPER, SolverLimits(likeness_nodes=20)).split.parts.values()))
        < sorted(by_lot)[0]
    )


def test_the_order_of_the_catalogue_changes_nothing() -> None:
    entries = catalogue(43, 7)
    first = propose(entries, PAPER, QUICK)
    assert all(propose(shuffled(entries, seed), PAPER, QUICK) == first for seed in range(1))


def test_what_is_left_over_is_in_no_split() -> None:
    proposal = propose(catalogue(30, 1), (8, 4, 4), QUICK)
    assert proposal.is_feasible
    assert proposal.split.sizes == (8, 4, 4)


def test_one_region_for_all_names_the_regions_and_how_many_lie_there() -> None:
    entries = tuple(entry(number, region="Gyeonggi", environment="lake") for number in range(43))
    proposal = propose(entries, PAPER, QUICK)
    assert not proposal.is_feasible
    assert [finding.code for finding in proposal.conflict] == [REGIONS, SIZES]
    assert "1 region(s): gyeonggi 43" in proposal.conflict[0].message
    assert "31 + 7 + 5 = 43 sequences are asked for" in proposal.conflict[1].message
    assert proposal.split.sizes == PAPER, "what is proposed all the same keeps the sizes"
    assert [finding.code for finding in proposal.findings if finding.severity == "error"] == [REGIONS]


def test_nights_in_two_regions_that_hold_too_many_for_test_name_night() -> None:
    """Night is in two regions of 19: whichever is test's, 24 sequences are left for train, and 31 are asked for."""
    nights = tuple(entry(n, region="AB"[n % 2], illumination="night" if n < 6 else "day") for n in range(38))
    days = tuple(entry(40 + n) for n in range(5))
    proposal = propose((*nights, *days), PAPER, QUICK)
    assert {finding.code for finding in proposal.conflict} == {LIGHT, REGIONS, SIZES}
    night = next(finding for finding in proposal.conflict if finding.code == LIGHT)
    assert night.message == "night in each split: 6 sequences have it, in 2 region(s): a 3, b 3"


def test_more_than_there_are_names_the_sizes_alone() -> None:
    proposal = propose(catalogue(20, 3), PAPER, QUICK)
    assert [finding.code for finding in proposal.conflict] == [SIZES]
    assert "there are 20" in proposal.conflict[0].message


def test_too_many_short_sequences_name_the_length() -> None:
    entries = (*catalogue(30, 3), *(entry(100 + n, duration_s=12.0) for n in range(13)))
    proposal = propose(entries, PAPER, QUICK)
    assert [finding.code for finding in proposal.conflict] == [LENGTH, SIZES]
    assert proposal.conflict[0].message.startswith("13 of 43 sequences are shorter than 20 s: run-100")


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
    with pytest.raises(BadSizesError, match="three whole numbers"):
        propose(catalogue(3, 0), sizes)


def test_a_catalogue_without_end_is_refused() -> None:
    with pytest.raises(CatalogueTooLargeError, match="2001 sequences"):
        propose([entry(number) for number in range(2001)], PAPER)


def test_an_empty_catalogue_is_refused() -> None:
    with pytest.raises(EmptyCatalogueError, match="no labelled sequence"):
        propose((), (1, 0, 0))


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


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(3, 6), st.tuples(*[st.integers(0, 2)] * 3).filter(any))
def test_a_proposal_is_feasible_exactly_where_some_split_is(
    seed: int, sequences: int, sizes: tuple[int, int, int]
) -> None:
    entries = small(seed, sequences)
    proposal = propose(entries, sizes, QUICK)
    errors = [finding for finding in check_split(proposal.split, entries, sizes) if finding.severity == "error"]
    assert proposal.is_feasible == splits_that_pass(entries, sizes)
    assert proposal.is_feasible == (errors == [])


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10**6), st.integers(8, 16))
def test_what_is_claimed_feasible_passes_the_checks_and_what_is_not_breaks_a_rule(seed: int, sequences: int) -> None:
    entries = catalogue(sequences, seed, regions=2 + seed % 5)
    sizes = (sequences - 6, 3, 3)
    proposal = propose(entries, sizes, QUICK)
    codes = {finding.code for finding in check_split(proposal.split, entries, sizes) if finding.severity == "error"}
    assert proposal.is_feasible == (not codes)
