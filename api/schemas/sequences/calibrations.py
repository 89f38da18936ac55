"""Calibrations over the wire."""

from typing import Annotated

from pydantic import AliasChoices, Field, StringConstraints

from api.schemas.base import ID_EXAMPLE, PLAIN, Answer, Body, Instant, example
from stone_recordings.topics.profiles import LONGEST_TOPIC, MOST_TOPICS


class FindingItem(Answer):
    """Something noticed: `code` for programs, `message` for people, `topic` is the sensor or file it is about."""

    model_config = example(code="CAL-410", severity="warning", topic="CAM_FRONT", message="CAM_FRONT: |t| is 12.3 m")

    code: str
    severity: str
    topic: str
    message: str


class SensorItem(Answer):
    """One sensor that the calibration places on the robot; `frame_id` is that of its messages, "" if unknown."""

    model_config = example(name="CAM_FRONT", kind="camera", frame_id="cam_front")

    name: str
    kind: str
    frame_id: str = ""


class CalibrationItem(Answer):
    """An immutable calibration; a file of the same name in it and other bytes is the next version.

    It is true of recordings from `valid_from` up to `valid_to`; null is open on that side.
    """

    model_config = example(
        name="warthog-1",
        version=2,
        filename="warthog-1.yaml",
        format="native",
        findings=[],
        valid_from="2026-05-01T00:00:00Z",
    )

    id: str
    owner_id: str
    name: str
    version: int
    filename: str
    sha256: str
    format: str
    sensors: list[SensorItem]
    findings: list[FindingItem]
    valid_from: Instant | None = Field(validation_alias=AliasChoices("valid_from_ns", "valid_from"))
    valid_to: Instant | None = Field(validation_alias=AliasChoices("valid_to_ns", "valid_to"))
    created_at: Instant


class TransformChangeItem(Answer):
    """Translation of an origin (in the LiDAR's frame; the LiDAR's own in the ego frame), and its rotation."""

    model_config = example(translation_m=[0.0, 0.01, 0.0], distance_m=0.01, rotation_deg=0.2)

    translation_m: tuple[float, float, float]
    distance_m: float
    rotation_deg: float


class ValueChangeItem(Answer):
    """One value of a lens (`fx_px`, `distortion_0`, …), of a sensor's frame or of the robot (`max_slope_deg`, …).

    It is null for the side that has none.
    """

    model_config = example(key="fx_px", before=1000.0, after=1003.5)

    key: str
    before: float | str | None
    after: float | str | None


class SensorChangeItem(Answer):
    """One channel: `status` is same, changed, added or removed."""

    model_config = example(name="CAM_FRONT", kind="camera", status="changed", time_offset_ns=0)

    name: str
    kind: str
    status: str
    transform: TransformChangeItem
    time_offset_ns: int
    values: list[ValueChangeItem]


class CalibrationDiffItem(Answer):
    """The changes from the calibration `against` to `id`; `robot` are its footprint and the vehicle's limits."""

    model_config = example(
        against=ID_EXAMPLE,
        is_same=True,
        ego_from_lidar={"translation_m": [0.0, 0.0, 0.0], "distance_m": 0.0, "rotation_deg": 0.0},
        sensors=[],
        robot=[],
    )

    id: str
    against: str
    is_same: bool
    ego_from_lidar: TransformChangeItem
    sensors: list[SensorChangeItem]
    robot: list[ValueChangeItem]


TOPICS_EXAMPLE = {"lidar": "/lidar_points", "pose": "/novatel/oem7/inspvax", "CAM_FRONT": "/camera/front/image_raw"}
Part = Annotated[str, StringConstraints(pattern=r"^(lidar|pose|imu|(CAM|RADAR)(_[A-Z0-9]+){1,4})$", max_length=64)]
TopicName = Annotated[str, StringConstraints(pattern=PLAIN, min_length=1, max_length=LONGEST_TOPIC)]


class ProfileBody(Body):
    """The topic of each part that is chosen; the others are resolved from each recording."""

    model_config = example(topics=TOPICS_EXAMPLE)

    topics: Annotated[dict[Part, TopicName], Field(max_length=MOST_TOPICS)]


class ProfileItem(Answer):
    """The topics chosen for a platform; `revision` is its ETag."""

    model_config = example(platform="warthog-1", topics=TOPICS_EXAMPLE, revision=1)

    platform: str
    topics: dict[str, str]
    revision: int
    created_at: Instant


class RolesAnswer(Answer):
    """The topics of a recording by role; `findings` has the unresolved ones."""

    model_config = example(platform="warthog-1", chosen={}, channels=TOPICS_EXAMPLE, findings=[])

    platform: str
    chosen: dict[str, str]
    channels: dict[str, str]
    findings: list[FindingItem]
