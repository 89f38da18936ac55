"""The keys of a native calibration file, and of the rig document that completes others, as their authors write them.

**Conventions.** Unknown keys are refused, so that a typo is not a silent default. Values are of the declared kind (no
numbers in quotes); what they must amount to is checked by `stone.sensors.calibration_checks`.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]
Rotation = Annotated[list[Vector], Field(min_length=3, max_length=3)]
Matrix = Annotated[list[Quaternion], Field(min_length=4, max_length=4)]
Name = Annotated[str, Field(min_length=1, max_length=100)]
Pixels = Annotated[int, Field(gt=0, le=100_000)]

ONE_TRANSFORM = "give either matrix, or translation_m with one of rotation_wxyz and rotation_matrix"


class Document(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class TransformDocument(Document):
    """`dst_from_src` in one of three spellings."""

    translation_m: Vector | None = None
    rotation_wxyz: Quaternion | None = None
    rotation_matrix: Rotation | None = None
    matrix: Matrix | None = None

    @model_validator(mode="after")
    def is_one_spelling(self) -> "TransformDocument":
        rotations = (self.rotation_wxyz is not None) + (self.rotation_matrix is not None)
        is_parts = self.translation_m is not None and rotations == 1 and self.matrix is None
        is_matrix = self.matrix is not None and self.translation_m is None and rotations == 0
        if not (is_parts or is_matrix):
            raise ValueError(ONE_TRANSFORM)
        return self


class FootprintDocument(Document):
    length_m: float
    width_m: float


class BoxDocument(Document):
    min_m: Vector
    max_m: Vector


class IntrinsicsDocument(Document):
    model: Literal["pinhole", "plumb_bob", "rational_polynomial", "equidistant"]
    width_px: Pixels
    height_px: Pixels
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: Annotated[list[float], Field(max_length=14)] = []


class SensorDocument(Document):
    kind: Literal["camera", "radar", "ins", "imu", "lidar"]
    lidar_from_sensor: TransformDocument
    frame_id: Annotated[str, Field(max_length=100)] = ""
    time_offset_ns: Annotated[int, Field(ge=-(10**12), le=10**12)] = 0
    intrinsics: IntrinsicsDocument | None = None


class CalibrationDocument(Document):
    stone_calibration: Literal[1]
    name: Name
    ego_from_lidar: TransformDocument
    footprint: FootprintDocument | None = None
    self_boxes_ego: Annotated[list[BoxDocument], Field(max_length=100)] = []
    sensors: Annotated[dict[Name, SensorDocument], Field(max_length=100)] = {}


class RigTransform(TransformDocument):
    parent: Name
    child: Name


class RigSensor(Document):
    """`kind` where the frame's name does not say it; sizes where the other file does not."""

    frame: Name
    kind: Literal["camera", "radar", "ins", "imu", "lidar"] | None = None
    frame_id: Annotated[str, Field(max_length=100)] | None = None
    time_offset_ns: Annotated[int, Field(ge=-(10**12), le=10**12)] | None = None
    width_px: Pixels | None = None
    height_px: Pixels | None = None


class RigDocument(Document):
    stone_rig: Literal[1]
    name: Name | None = None
    ego: Name | None = None
    lidar: Name | None = None
    transforms: Annotated[list[RigTransform], Field(max_length=100)] = []
    sensors: Annotated[dict[Name, RigSensor], Field(max_length=100)] = {}
    footprint: FootprintDocument | None = None
    self_boxes_ego: Annotated[list[BoxDocument], Field(max_length=100)] = []
