"""A sequence with everything its page shows: labels, a recording with its report, pictures, a run.

**Conventions.** Labels and scene are `viewer_world`'s; pictures are small JPEGs in one colour per camera, told apart
by frame; the recording's report is a record as ingest writes it, of clocks and gaps by hand.
"""

import io
import json
from pathlib import Path
from typing import Any

from PIL import Image
from sqlalchemy import select

from services.domain.viewer.playback import INDEX, PLAYBACK, PlaybackChannels, camera_file, index_record
from services.runtime.orm import Artefact, LabelSet, Preview, Upload, new_id
from services.runtime.platform import Platform
from services.runtime.store import blobs
from testing.api.serving import Person
from testing.worlds import made
from testing.worlds.frame_tables import frame_table_bytes
from testing.worlds.rows import recording_of
from testing.worlds.viewer_world import Run, viewed
from tests.web.listed_world import picture_of

CAMERAS = ("CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT", "CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT")
FRAMES = 12
SPAN_NS = 60_000_000_000


def _band(from_m: float, to_m: float | None, voxels: int, recall: float | None) -> dict[str, float | None]:
    return {"from_m": from_m, "to_m": to_m, "voxels": voxels, "recall": recall}


REPORT: dict[str, Any] = {
    "code_version": "0.1.0",
    "pose_source": "/ins (INSPVAX)",
    "excluded": [{}],
    "parameters": {"profile": "paper"},
    "class_share_of_occupied": {
        "traversable": 0.1,
        "potentially_traversable": 0.2,
        "non_traversable": 0.7,
    },
    "observed_ratio": {"lidar": 0.38, "camera": 0.2},
    "map": {"voxels": 80826, "points": 372429},
    "recordings": [
        {"name": "run.mcap", "offset_ns": 0, "sigma_ns": None, "known_by": ["reference"]},
        {"name": "cameras.mcap", "offset_ns": -80_000_000, "sigma_ns": 412_000, "known_by": ["camera motion"]},
    ],
    "findings": [
        {"code": "TIM-201", "severity": "warning", "topic": "/ins", "message": "Stamped on the host."},
        {"code": "LAB-603", "severity": "warning", "topic": "", "message": "the track spans 3.11 m"},
    ],
    "held_out": {
        "recall": 0.725,
        "judged_m": 20.0,
        "from_first_half": {"by_distance": [_band(0.0, 5.0, 200, 1.0), _band(5.0, None, 0, None)]},
        "from_second_half": {"by_distance": [_band(0.0, 5.0, 100, 0.7), _band(5.0, None, 100, 0.2)]},
    },
}


ASKED: dict[str, Any] = {
    "profile": "paper",
    "parameters": {"reference.alpha": 0.1},
    "odometry_topic": "kiss-icp",
    "lidar_topic": "/lidar",
    "ground": "auto",
    "names_recordings": True,
    "clock_offsets_ns": {"cameras.mcap": -80_000_000},
    "stages": ["synchronise", "label"],
}
"""What the run that labelled it may have been asked for."""


def whole_sequence(platform: Platform, owner: Person) -> dict[str, Any]:
    """Its id, name and tokens; private, labelled, with a recording and a playback."""
    facts = viewed(platform, owner, Run(frames=FRAMES))
    table = frame_table_bytes(facts["tokens"], made.START_NS, b"", ("SYN-504", "POS-401"))
    pictures = {"bev.png": picture_of(1), "map.png": _picture((60, 90, 120), "PNG", (1200, 800))}
    replace_files(
        platform,
        facts["label_set_id"],
        {"report.json": json.dumps(REPORT).encode(), "frames.parquet": table, **pictures},
    )
    recording_id = reported_recording(platform, owner, facts["id"])
    _overlays(platform, facts)
    return {**facts, "recording_id": recording_id}


def playback(platform: Platform, facts: dict[str, Any]) -> None:
    """Pictures of every camera at every frame."""
    files = {
        camera_file(channel, token): _picture((40 * place, 20 * number, 120), "JPEG")
        for place, channel in enumerate(CAMERAS)
        for number, token in enumerate(facts["tokens"])
    }
    made.export(platform, facts["id"], {**files, INDEX: index_record(PlaybackChannels(CAMERAS, False))}, PLAYBACK)


def reported_recording(platform: Platform, owner: Person, sequence_id: str) -> str:
    """The id of a registered recording with inspection, quality and pictures."""
    upload_id = made.upload(platform, owner, filename="run.mcap", state="recorded")
    with platform.database.transaction() as session:
        row = recording_of(session.get_one(Upload, upload_id), sequence_id, "registered")
        row.inspection, row.quality = inspection(), quality()
        row.findings = [{"code": "TIM-204", "severity": "warning", "topic": "/lidar", "message": "1 gap at 10 Hz."}]
        session.add(row)
        session.flush()
        for name, size in (("cameras.jpg", (960, 400)), ("sweep.png", (640, 640)), ("track.png", (640, 640))):
            content = _picture((80, 100, 90), "PNG" if name.endswith("png") else "JPEG", size)
            _preview(session, platform, (sequence_id, row.id, ""), name, content)
        return row.id


def inspection() -> dict[str, Any]:
    """A recording of a minute: a steady LiDAR, a camera, an INS stamped on the host, a radar 37 s off."""
    return {
        "duration_ns": SPAN_NS,
        "topics": [],
        "channels": {"lidar": "/lidar", "pose": "/ins", "CAM_FRONT": "/front"},
        "clocks": {
            "topics": [
                _clock("/lidar", "lidar", 108_000_000, 12_000),
                _clock("/front", "camera", 22_000_000, 900_000, drift_ppm=3.1, gaps=1),
                _clock("/ins", "ins", 200_000, 5_000_000, stamp_source="host", own_offset_ns=11_100_000),
                _clock("/radar", "radar", -37_000_000_000, 40_000, drift_ppm=44.0, constant="TAI-UTC", steps_back=2),
                _clock("/tf", "tf", 0, 0),
            ],
            "imu_lag": {
                "topic": "/imu",
                "reference": "/ins",
                "lag_ns": 124_135,
                "sigma_ns": 60_258,
                "correlation": 0.99,
            },
        },
    }


def quality() -> dict[str, Any]:
    at_ns = [SPAN_NS * place // 16 for place in range(16)]
    return {
        "score": 78,
        "deductions": [{"code": "TIM-202", "points": 12, "message": "/radar: its clock differs by 37.000 s."}],
        "left_out": [],
        "start_ns": 0,
        "coverage": [
            _coverage("/lidar", "lidar", [1.0] * 40 + [0.4] + [0.0] * 3 + [1.0] * 36, [[30 * 10**9, 33 * 10**9]]),
            _coverage("/front", "camera", [1.0] * 80, []),
            _coverage("/tf", "tf", [1.0] * 80, []),
        ],
        "cameras": [
            {
                "topic": "/front",
                "channel": "CAM_FRONT",
                "size_px": [480, 300],
                "at_ns": at_ns,
                "sharpness": [10.0 + place for place in range(16)],
                "brightness_ratio": [0.5] * 16,
                "dark_ratio": [0.0] * 16,
                "bright_ratio": [0.0] * 16,
            }
        ],
        "lidars": [
            {"topic": "/lidar", "at_ns": at_ns, "slots": [57600] * 16, "valid_ratio": [0.9] * 16}
            | {"range_m": [6.0] * 16}
        ],
        "radars": [{"topic": "/radar", "at_ns": at_ns, "detections": list(range(40, 56))}],
        "rtk": {
            "topic": "/bestpos",
            "at_ns": at_ns,
            "words": ["fixed"] * 10 + ["float"] * 4 + ["other"] * 2,
            "stdev_m": [0.012] * 10 + [0.3] * 6,
            "fixed_ratio": 0.625,
        },
    }


def replace_files(platform: Platform, label_set_id: str, files: dict[str, bytes]) -> None:
    """Artefacts of the label set, in the place of those of the same names."""
    with platform.database.transaction() as session:
        session.get_one(LabelSet, label_set_id)
        laid = select(Artefact).where(Artefact.label_set_id == label_set_id, Artefact.name.in_(files))
        for row in session.scalars(laid):
            session.delete(row)
        session.flush()
        for name, content in files.items():
            made._artefact(session, platform, label_set_id, name, content)


def _overlays(platform: Platform, facts: dict[str, Any]) -> None:
    with platform.database.transaction() as session:
        recipe = session.get_one(LabelSet, facts["label_set_id"]).recipe
        for place, camera in enumerate(CAMERAS):
            content = _picture((20 * place, 90, 140), "JPEG")
            _preview(session, platform, (facts["id"], None, recipe), f"overlay_{camera}.jpg", content)


def _preview(session: Any, platform: Platform, of: tuple[str, str | None, str], name: str, content: bytes) -> None:
    path = Path(platform.settings.root) / f"made-{new_id()}"
    path.write_bytes(content)
    blob = blobs.keep(session, platform.store, path)
    media = "image/png" if name.endswith("png") else "image/jpeg"
    row = Preview(sequence_id=of[0], recording_id=of[1], recipe=of[2], name=name, media_type=media)
    row.blob_sha256, row.size_bytes = blob.sha256, len(content)
    session.add(row)


def _picture(colour: tuple[int, int, int], form: str, size: tuple[int, int] = (320, 200)) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", size, tuple(min(255, part) for part in colour)).save(stream, form)
    return stream.getvalue()


def _clock(topic: str, role: str, offset_ns: int, jitter_ns: int, **said: Any) -> dict[str, Any]:
    return {
        "topic": topic,
        "role": role,
        "count": 600,
        "rate_hz": 10.0,
        "stamp_source": "sensor",
        "offset_ns": offset_ns,
        "drift_ppm": 0.2,
        "drift_sigma_ppm": 0.1,
        "jitter_ns": jitter_ns,
        "constant": "",
        "gaps": 0,
        "steps_back": 0,
        "worst_step_back_ns": 0,
        "repeats": 0,
        "own_offset_ns": None,
        "own_jitter_ns": None,
        **said,
    }


def _coverage(topic: str, role: str, covered: list[float], gaps_ns: list[list[int]]) -> dict[str, Any]:
    return {
        "topic": topic,
        "role": role,
        "count": 600,
        "rate_hz": 10.0,
        "first_ns": 0,
        "last_ns": SPAN_NS,
        "covered_ratio": sum(covered) / len(covered),
        "covered": covered,
        "rates_hz": [10.0] * 40,
        "gaps_ns": gaps_ns,
    }
