"""The score is full for nothing, adds up, and never rises by what is found."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone.findings import Finding
from stone_recordings.report.quality.facts import CameraFacts, Coverage, Facts, LidarFacts, RadarFacts, RtkFacts
from stone_recordings.report.quality.score import FULL_SCORE, POINTS_OF_CODE, deductions_of, score_of

FINDINGS = st.lists(
    st.builds(
        Finding,
        st.sampled_from([*POINTS_OF_CODE, "MSG-301", "CAL-404", "GNS-301", "XYZ-999"]),
        st.sampled_from(["error", "warning", "info"]),
        st.sampled_from(["", "/a", "/b"]),
        st.just("Something is wrong."),
    ),
    max_size=12,
)
COVERED = Coverage("/imu", "imu", 100, 100.0, 0, 10**9, 1.0, (1.0,), (100.0,))
CAMERA = CameraFacts("/cam", "CAM_FRONT", (640, 480), (0, 1), (50.0, 52.0), (0.5, 0.5), (0.0, 0.0), (0.0, 0.0))
GOOD = Facts(
    0,
    (COVERED,),
    tuple(replace(CAMERA, topic=f"/cam{number}") for number in range(4)),
    (LidarFacts("/lidar", (0,), (1000,), (0.8,), (12.0,)),),
    (RadarFacts("/radar", (0, 1), (120, 130)),),
    RtkFacts("/ins", (0, 1), ("fixed", "fixed"), (0.01, 0.01)),
)


def codes(facts: Facts) -> dict[str, int]:
    return {deduction.code: deduction.points for deduction in deductions_of((), facts)}


def test_nothing_wrong_information_and_what_is_measured_elsewhere_cost_nothing() -> None:
    assert deductions_of((), GOOD) == ()
    assert deductions_of((), Facts()) == ()
    assert score_of(()) == FULL_SCORE
    told = (Finding("BAG-011", "info", "", "No index."), Finding("GNS-301", "warning", "/ins", "RTK was rarely fixed."))
    assert deductions_of(told, GOOD) == ()
    silent = replace(COVERED, covered_ratio=0.1)
    assert codes(replace(GOOD, coverage=(replace(silent, role="other"), replace(silent, covered_ratio=None)))) == {}


@given(findings=FINDINGS)
def test_the_score_is_what_the_named_deductions_leave(findings: list[Finding]) -> None:
    deductions = deductions_of(findings, GOOD)
    assert score_of(deductions) == max(0, 100 - sum(one.points for one in deductions))
    assert len({one.code for one in deductions}) == len(deductions)
    assert all(one.points > 0 and one.message for one in deductions)
    assert list(deductions) == sorted(deductions, key=lambda one: (-one.points, one.code))


@given(findings=FINDINGS, more=FINDINGS)
def test_what_is_found_never_raises_the_score(findings: list[Finding], more: list[Finding]) -> None:
    assert score_of(deductions_of([*findings, *more], GOOD)) <= score_of(deductions_of(findings, GOOD))


@given(findings=FINDINGS)
def test_the_order_of_findings_does_not_matter_to_the_score(findings: list[Finding]) -> None:
    assert score_of(deductions_of(findings, GOOD)) == score_of(deductions_of(findings[::-1], GOOD))


@pytest.mark.parametrize(("words", "points"), [(("fixed",) * 19 + ("float",), 0), (("float",), 20), (("other",), 20)])
def test_rtk_costs_in_proportion_to_what_is_missing(words: tuple[str, ...], points: int) -> None:
    rtk = RtkFacts("/ins", tuple(range(len(words))), words, (0.1,) * len(words))  # type: ignore[arg-type]
    assert codes(replace(GOOD, rtk=rtk)) == ({"GNS-301": points} if points else {})


@pytest.mark.parametrize(("ratio", "points"), [(1.0, 0), (0.99, 0), (0.9, 6), (0.0, 25)])
def test_silence_of_a_sensor_costs_by_its_share(ratio: float, points: int) -> None:
    found = codes(replace(GOOD, coverage=(replace(COVERED, covered_ratio=ratio),)))
    assert found == ({"QLT-601": points} if points else {})


def test_one_muddy_lens_among_clean_ones_is_named_and_two_are_not_compared() -> None:
    muddy = replace(CAMERA, topic="/muddy", sharpness=(2.0, 3.0))
    (deduction,) = deductions_of((), replace(GOOD, cameras=(*GOOD.cameras, muddy)))
    assert (deduction.code, deduction.points) == ("QLT-602", 5)
    assert deduction.message.startswith("/muddy is much less sharp")
    pair = (CAMERA, replace(CAMERA, topic="/soft", sharpness=(5.0, 5.0)))
    assert codes(replace(GOOD, cameras=pair)) == {}
    covered = replace(CAMERA, topic="/covered", sharpness=(0.1, 0.1), dark_ratio=(1.0, 1.0))
    assert codes(replace(GOOD, cameras=(CAMERA, covered))) == {"QLT-602": 5, "QLT-603": 3}


def test_clouds_without_returns_and_scans_without_detections_are_named() -> None:
    empty = RadarFacts("/radar", (0, 1, 2), (0, 0, 90))
    blind = LidarFacts("/lidar", (0,), (1000,), (0.05,), (3.0,))
    assert codes(replace(GOOD, radars=(empty,), lidars=(blind,))) == {"QLT-604": 10, "QLT-605": 3}
