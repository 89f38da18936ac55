"""What a sequence's page works out: track, timeline, clocks, recording, stages, from records and tables by hand."""

from typing import Any

import numpy as np
import pytest

from services.labeler.tables import CLASS_COLUMNS, POSE_COLUMNS, STDEV_COLUMNS
from stone.splits.composition import duration_ns, path_length_m
from testing.worlds.frame_tables import frame_columns
from tests.web.sequence_world import inspection, quality
from web.sequence import frame_table, recording
from web.sequence.frame_table import FrameTable, table_of
from web.sequence.recording import recording_view
from web.sequence.timeline import timeline_of
from web.sequence.track import ground_of, is_sure, speeds_m_s, track_of

START_NS = 1_777_800_000_000_000_000
TOKENS = [f"{number:032x}" for number in range(12)]
ABOUT = {"pose_source": "/ins", "map_origin_deg_m": [48.0, 11.5, 559.0]}


def table(**columns: list[Any]) -> FrameTable:
    return table_of(frame_columns(TOKENS, START_NS, ("SYN-504",)) | columns, ABOUT)


def test_the_columns_that_are_read_are_those_that_the_labeler_writes() -> None:
    assert set(frame_table.POSITION) < set(POSE_COLUMNS)
    assert frame_table.STDEV == STDEV_COLUMNS
    assert CLASS_COLUMNS[1:] == frame_table.CLASSES


def test_frames_and_what_was_excluded_stand_apart() -> None:
    read = table()
    assert read.tokens == tuple(TOKENS)
    assert [one.code for one in read.excluded] == ["SYN-504"]
    assert read.times_s[-1] == pytest.approx(1.1)
    assert read.cameras == ("CAM_BACK", "CAM_FRONT", "CAM_FRONT_LEFT")


def test_a_table_of_an_earlier_version_lacks_columns_and_is_read_without_them() -> None:
    columns = frame_columns(TOKENS, START_NS)
    for name in ("rtk_status", "pose_gap_ns", *STDEV_COLUMNS):
        del columns[name]
    drawn = track_of(table_of(columns, {}))
    assert drawn is not None
    assert [plot.title for plot in drawn.plots] == ["Speed", "Elevation"]
    assert "sure_ratio" not in drawn.facts, "nothing says that RTK was fixed"


def test_a_robot_at_a_steady_pace_has_that_speed_all_along() -> None:
    columns = {"x_m": [0.15 * step for step in range(12)], "y_m": [0.0] * 12, "z_m": [0.0] * 12}
    straight = table(**{name: [*values, None] for name, values in columns.items()})
    np.testing.assert_allclose(speeds_m_s(straight), 1.5)
    drawn = track_of(straight)
    assert drawn is not None
    assert drawn.facts["distance_m"] == pytest.approx(path_length_m(straight.positions_map_m)) == pytest.approx(1.65)
    assert drawn.facts["duration_s"] == duration_ns(straight.stamps_ns) / 1e9, "as the label set has it"
    assert drawn.facts["climb_m"] == 0.0


def test_over_a_pause_no_speed_is_known_and_no_line_is_drawn() -> None:
    stamps = [START_NS + step * 100_000_000 + (10**10 if step > 5 else 0) for step in range(13)]
    paused = table(stamp_ns=stamps)
    assert np.flatnonzero(np.isnan(speeds_m_s(paused))).tolist() == [5, 6]
    assert ground_of(paused).sure.count("M") + ground_of(paused).unsure.count("M") == 4


def test_a_track_is_sure_where_rtk_was_fixed_and_both_kinds_make_up_the_whole() -> None:
    read = table()
    assert np.flatnonzero(~is_sure(read)).tolist() == [2, 3]
    ground = ground_of(read)
    assert ground.sure.count("L") + ground.unsure.count("L") == len(read) - 1
    assert ground.unsure.count("L") == 2


def test_the_ground_is_drawn_north_up_with_all_of_the_track_inside() -> None:
    ground = ground_of(table())
    left, top, wide, high = map(float, ground.view_box.split())
    assert ground.end[1] < ground.start[1], "the robot drove to the north, so up"
    for x, y in (ground.start, ground.end):
        assert left < x < left + wide
        assert top < y < top + high
    assert high >= 0.44 * wide


def test_a_lone_frame_is_a_track_too_and_no_frame_is_none() -> None:
    assert track_of(table_of(frame_columns(TOKENS[:1], START_NS), ABOUT)) is not None
    assert track_of(table_of(frame_columns([], START_NS), ABOUT)) is None
    assert timeline_of(table_of(frame_columns([], START_NS), ABOUT), None) is None


def test_the_timeline_opens_at_the_asked_frame_and_else_in_the_middle() -> None:
    read = table()
    asked, unknown = timeline_of(read, TOKENS[4]), timeline_of(read, "f" * 32)
    assert asked is not None
    assert unknown is not None
    assert (asked.index, asked.token, asked.voxels) == (4, TOKENS[4], (140, 400, 620))
    assert unknown.index == 6
    assert asked.cameras == ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_BACK")


def test_clocks_that_nobody_keeps_time_by_are_left_out_and_the_wrong_ones_marked() -> None:
    found = recording.clocks_of(inspection()["clocks"])
    assert found is not None
    rows = {row.topic: row for row in found.rows}
    assert set(rows) == {"/lidar", "/front", "/ins", "/radar"}
    assert [topic for topic, row in rows.items() if row.offset and row.offset.is_bad] == ["/radar"]
    assert [topic for topic, row in rows.items() if row.drift and row.drift.is_bad] == ["/radar"]
    assert rows["/radar"].marks == ("TAI-UTC", "2 steps back")
    assert rows["/ins"].marks == ("11.1 ms after its own time",)
    assert {row.against for row in found.rows if row.jitter} <= {"sensor time", "record time"}


def test_offsets_keep_their_order_and_whiskers_reach_around_their_dot() -> None:
    found = recording.clocks_of(inspection()["clocks"])
    assert found is not None
    whiskers = {row.topic: row.offset for row in found.rows}
    places = [whiskers[topic].at for topic in ("/radar", "/ins", "/front", "/lidar")]  # type: ignore[union-attr]
    assert places == sorted(places)
    assert all(one.low <= one.at <= one.high for one in whiskers.values() if one)
    assert any(tick.text == "0" for tick in found.offset_ticks)


def test_a_recording_is_shown_with_its_gaps_and_without_a_quality_report_by_its_clocks_alone() -> None:
    view = recording_view(inspection(), quality())
    lidar = view.sensors[0]
    assert [row.topic for row in view.sensors] == ["/lidar", "/front"]
    assert [row.topic for row in view.others] == ["/tf"]
    assert (lidar.channel, lidar.gaps[0].x, lidar.gaps[0].width) == ("lidar", 500.0, 50.0)
    assert view.rtk is not None
    assert [span.style for span in view.rtk.spans] == ["rtk-fixed", "rtk-float", "rtk-other"]
    bare = recording_view(inspection(), None)
    assert (bare.score, bare.sensors, bare.rtk) == (None, (), None)
    assert bare.clocks is not None
