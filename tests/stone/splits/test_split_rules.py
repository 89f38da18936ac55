"""Each rule of a split is broken alone, and kept alone."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone.splits.composition import CatalogueEntry
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
from stone.splits.surroundings import DAYLIGHT, ENVIRONMENTS
from tests.stone.catalogues import catalogue, entry


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


def test_a_sequence_in_two_splits_is_found() -> None:
    a, b = entry(1), entry(2)
    finding = only(check_whole(split_of((a,), (b,), (a,)), (a, b)))
    assert (finding.code, finding.severity, finding.sequences) == (WHOLE, "error", (a.id,))
    assert "more than once" in finding.message


def test_a_sequence_that_is_not_in_the_catalogue_is_found() -> None:
    finding = only(check_whole(Split(("x",)), (entry(1),)))
    assert (finding.code, finding.sequences) == (WHOLE, ("x",))
    assert "not in the catalogue" in finding.message


@pytest.mark.parametrize(
    ("same", "why"), [({"name": "Run-02"}, "their name"), ({"recordings": ("ab", "cd")}, "a recording")]
)
def test_one_sequence_twice_is_found_even_within_one_split(same: dict[str, object], why: str) -> None:
    a, b = entry(1, **same), entry(2, recordings=("cd",))
    finding = only(check_whole(split_of((a, b)), (a, b)))
    assert (finding.code, finding.sequences) == (WHOLE, (a.id, b.id))
    assert why in finding.message


def test_labels_that_anybody_may_have_are_told_of_in_test_and_nowhere_else() -> None:
    a, b, c = (entry(number, exposure="it is public") for number in (1, 2, 3))
    finding = only(check_exposed(split_of((a,), (b,), (c, entry(4))), (a, b, c, entry(4))))
    assert (finding.code, finding.severity, finding.sequences) == (EXPOSED, "warning", (c.id,))
    assert finding.message == f"{c.name} is in test and its labels may be known: it is public"


def test_twins_of_which_one_is_left_out_are_not_found() -> None:
    a, b = entry(1, name="run"), entry(2, name="run")
    assert check_whole(split_of((a,)), (a, b)) == ()


@pytest.mark.parametrize(("duration_s", "is_found"), [(20.0, False), (19.99, True), (0.0, True)])
def test_a_sequence_below_twenty_seconds_is_found(duration_s: float, is_found: bool) -> None:
    a = entry(1, duration_s=duration_s)
    findings = check_length(split_of((), (a,)), (a,))
    assert [(f.code, f.severity, f.sequences) for f in findings] == [(LENGTH, "error", (a.id,))] * is_found


@pytest.mark.parametrize(("in_train", "in_test", "is_found"), [("a", "b", False), ("a", "A", True), ("", "", True)])
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
    assert finding.message == "night is not in val, though 11 sequences have it"


def test_a_split_without_an_environment_is_found_where_there_is_enough_of_it() -> None:
    parts = everywhere()
    dry = tuple(one for one in parts[2] if one.environment != "lake")
    finding = only(check_places(split_of(parts[0], parts[1], dry), sum(parts, ())))
    assert (finding.code, finding.severity) == (SEPARATED_PLACES, "error")
    assert finding.message.startswith("lake is not in test")


@pytest.mark.parametrize(
    ("nights", "obstacle"),
    [
        ((), "0 sequence"),
        (({}, {}), "2 sequence"),
        (({}, {}, {"duration_s": 19.0}), "2 sequence"),
        (({"region": "A"}, {"region": "a"}, {"region": "A"}), "lie in one region"),
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
    a = entry(1, environment="moon", illumination="", region="")
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
