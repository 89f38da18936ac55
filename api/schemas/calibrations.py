"""Calibrations over the wire."""

from datetime import datetime

from api.schemas.base import ID_EXAMPLE, SHA256_EXAMPLE, Answer, example


class FindingItem(Answer):
    """Something noticed: `code` for programs, `message` for people, `topic` is the sensor or file it is about."""

    model_config = example(code="CAL-410", severity="warning", topic="CAM_FRONT", message="CAM_FRONT: |t| is 12.3 m")

    code: str
    severity: str
    topic: str
    message: str


class SensorItem(Answer):
    """One sensor the calibration places on the robot."""

    model_config = example(name="CAM_FRONT", kind="camera")

    name: str
    kind: str


class CalibrationItem(Answer):
    """An immutable calibration; a file of the same name in it and other bytes is the next version."""

    model_config = example(
        id=ID_EXAMPLE,
        owner_id=ID_EXAMPLE,
        name="warthog-1",
        version=2,
        filename="warthog-1.yaml",
        sha256=SHA256_EXAMPLE,
        sensors=[{"name": "CAM_FRONT", "kind": "camera"}],
        findings=[],
        created_at="2026-05-03T09:12:44.120000Z",
    )

    id: str
    owner_id: str
    name: str
    version: int
    filename: str
    sha256: str
    sensors: list[SensorItem]
    findings: list[FindingItem]
    created_at: datetime
