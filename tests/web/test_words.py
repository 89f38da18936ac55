"""Values as people read them: sizes, spans, states; the stages of a run; a rig drawn where its calibration says."""

import math
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from api.views.admin import JobSpan
from services.eval import queue_handlers as scoring
from services.ingest import queue_handlers as ingest
from services.labeler import queue_handlers as labelling
from services.maintenance.notifications import delivery
from services.runtime.jobs.queries import TITLES
from services.runtime.notifications.events import TOLD_FAILED
from services.runtime.platform import Platform
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount
from web import words
from web.rig import FARTHEST_M, rig_of
from web.stage_picture import stage_picture
from web.zones import written

SAID: tuple[tuple[Callable[[Any], str], Any, str], ...] = (
    (words.size, 0, "0 B"), (words.size, 999, "999 B"), (words.size, 1000, "1.0 kB"), (words.size, 99_499, "99.5 kB"),
    (words.size, 123_456, "123 kB"), (words.size, 999_600, "1.0 MB"), (words.size, 2_500_000_000, "2.5 GB"),
    (words.span, 0.04, "0.0 s"), (words.span, 9.94, "9.9 s"), (words.span, 59.6, "1 min"),
    (words.span, 61, "1 min 1 s"), (words.span, 3600, "1 h"), (words.span, 90_061, "1 d 1 h"),
    (words.span, 86_460, "1 d"),
    (words.percent, 0.2913, "29.1 %"), (words.percent, 1.0, "100.0 %"),
    (words.stage_word, "store", "saving"), (words.stage_word, "labeler.fuse", "Fuse sweeps"),
    (words.stage_word, "another", "another"),
    (words.size, None, "–"), (words.span, None, "–"), (words.percent, None, "–"),
)  # fmt: skip


@pytest.mark.parametrize(("words_of", "value", "said"), SAID)
def test_a_value_is_written_as_people_read_it(words_of: Callable[[Any], str], value: Any, said: str) -> None:
    assert words_of(value) == said


def test_a_time_is_written_in_the_readers_zone_and_says_when_it_is_utc() -> None:
    moment = datetime(2026, 11, 21, 20, 10, tzinfo=UTC)
    assert written(moment, UTC) == "2026-11-21 20:10 UTC"
    assert written(moment, ZoneInfo("Asia/Seoul")) == "2026-11-22 05:10"
    assert words.iso(moment) == "2026-11-21T20:10:00Z"


SECOND = 10**9


def span(kind: str, began_s: int | None, made: int) -> JobSpan:
    ended_ns = None if began_s is None else (began_s + 2) * SECOND
    state = "queued" if began_s is None else "succeeded"
    started_ns = None if began_s is None else began_s * SECOND
    return JobSpan(f"{made:032x}", kind, state, 1, 0, started_ns, ended_ns)


def test_rows_stand_in_the_order_in_which_their_stages_began_and_those_to_come_last() -> None:
    spans = [
        span("labeler.fuse", 3, 0),
        span("labeler.surface", 9, 1),
        span("labeler.sight", 5, 2),
        span("labeler.publish", None, 3),
        span("ingest.synchronise", 1, 4),
        span("labeler.surface", 4, 5),
    ]
    picture = stage_picture(spans, 20 * SECOND)
    assert picture is not None
    assert [row.kind for row in picture.rows] == [
        "ingest.synchronise",
        "labeler.fuse",
        "labeler.surface",
        "labeler.sight",
        "labeler.publish",
    ]
    assert picture.rows[1].title == "Fuse sweeps"


def test_every_kind_of_job_and_run_has_a_title(platform: Platform) -> None:
    kinds = {kind for module in (ingest, labelling, scoring, delivery) for kind in module.handlers(platform)}
    assert kinds | set(TOLD_FAILED) | {"score"} <= set(TITLES)


LENS = CameraIntrinsics("pinhole", 800, 600, 400.0, 400.0, 400.0, 300.0)  # 90° wide
FORWARD = np.array([0.5, -0.5, 0.5, -0.5])  # an optical frame that looks along x


def rig(*mounts: Mount, height_m: float = 1.0) -> Calibration:
    return Calibration("rig", SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([0, 0, height_m])), mounts)


def camera(at_m: tuple[float, float, float], name: str = "CAM_FRONT") -> Mount:
    return Mount(name, "camera", SE3.from_parts(FORWARD, np.array(at_m)), intrinsics=LENS)


def test_forward_is_up_from_above_and_right_from_the_side() -> None:
    top, side = rig_of(rig(camera((0.4, 0.1, -0.2)))).views
    assert [(round(mark.x), round(mark.y)) for mark in top.marks] == [(0, 0), (-10, -40)]
    assert [(round(mark.x), round(mark.y)) for mark in side.marks] == [(0, -100), (40, -80)]


def test_a_camera_is_drawn_with_the_field_of_view_of_its_lens() -> None:
    front = rig_of(rig(camera((0.0, 0.0, 0.0)))).views[0].marks[1]
    numbers = front.wedge.replace("M", " ").replace("L", " ").replace("A", " ").replace("Z", "").split()
    (x0, y0), (x1, y1) = [(float(numbers[at]), float(numbers[at + 1])) for at in (2, 9)]
    assert x0 == pytest.approx(-x1)
    assert y0 == pytest.approx(y1)
    assert math.degrees(math.atan2(x1, -y1)) == pytest.approx(45.0, abs=0.2)


def test_a_sensor_that_is_said_to_be_far_away_is_named_and_not_drawn() -> None:
    drawn = rig_of(rig(camera((FARTHEST_M + 1, 0.0, 0.0)), camera((0.1, 0.0, 0.0), "CAM_BACK")))
    assert drawn.left_out == ("CAM_FRONT",)
    assert [mark.name for mark in drawn.views[0].marks] == ["LIDAR", "CAM_BACK"]
    assert len(drawn.sensors) == 3


def test_of_names_in_one_place_one_is_written() -> None:
    at = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.zeros(3))
    top = rig_of(rig(Mount("INS", "ins", at), Mount("IMU", "imu", at))).views[0]
    assert [mark.label for mark in top.marks] == ["lidar", "", ""]


def test_a_finding_names_its_subject_once() -> None:
    puts = {"code": "CAL-430", "topic": "CAM_FRONT", "message": "tf_static puts it 2.7 cm from the calibration."}
    assert words.sentence_of(puts) == "CAM_FRONT: tf_static puts it 2.7 cm from the calibration."
    assert words.sentence_of({**puts, "message": "CAM_FRONT: |t| is 12.3 m"}) == "CAM_FRONT: |t| is 12.3 m"
    assert words.sentence_of({"code": "LAB-603", "message": "The track spans 3.11 m."}) == "The track spans 3.11 m."
