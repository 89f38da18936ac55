"""Processing over the wire: what is asked for, and the frames that come of it."""

from typing import Annotated, Any, Literal

from pydantic import Field, JsonValue

from api.schemas.base import ID_EXAMPLE, SHA256_EXAMPLE, Answer, Body, example

Topic = Annotated[str, Field(max_length=256, pattern=r"^(/?[A-Za-z0-9_][A-Za-z0-9_/]*)?$")]
ParameterName = Annotated[str, Field(max_length=64, pattern=r"^[a-z][a-z0-9_.]*$")]
StageName = Annotated[str, Field(max_length=64, pattern=r"^[a-z][a-z_.]*$")]


class ProcessBody(Body):
    """How a sequence is to be labelled; what is left out is as the paper has it."""

    model_config = example(profile="paper", parameters={"voxel_m": 0.1}, odometry_topic="", lidar_topic="")

    profile: Literal["paper", "local"] = "paper"
    parameters: dict[ParameterName, JsonValue] = Field(default={}, max_length=64)
    odometry_topic: Topic = ""
    lidar_topic: Topic = ""
    stages: list[StageName] = Field(default=[], max_length=16)


class FrameItem(Answer):
    """A labelled frame in the order of time; `stamp_ns` is its LiDAR stamp."""

    model_config = example(token=ID_EXAMPLE, ordinal=17, stamp_ns=1777800000000000000)

    token: str
    ordinal: int
    stamp_ns: int


class FrameDetail(FrameItem):
    """A labelled frame, with where it comes from and what its `labels.npz` weighs."""

    model_config = example(
        token=ID_EXAMPLE,
        ordinal=17,
        stamp_ns=1777800000000000000,
        sequence_id=ID_EXAMPLE,
        label_set_id=ID_EXAMPLE,
        labels_bytes=20480,
        labels_sha256=SHA256_EXAMPLE,
        parameters={"profile": "paper"},
    )

    sequence_id: str
    label_set_id: str
    labels_bytes: int
    labels_sha256: str
    parameters: dict[str, Any]
