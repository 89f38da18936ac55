"""Processing over the wire: the request, and the resulting frames."""

from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import Field, StrictFloat, StrictInt

from api.schemas.base import ID_EXAMPLE, SHA256_EXAMPLE, Answer, Body, IdText, example
from services.domain.sequences.processing import ProcessRequest
from stone_files.joined_file import MOST_MEMBERS, MOST_OFFSET_NS

TOPIC_PATTERN = r"^/?[A-Za-z0-9_][A-Za-z0-9_/]*$"
LONGEST_TOPIC = 256
Topic = Annotated[str, Field(max_length=LONGEST_TOPIC, pattern=TOPIC_PATTERN)]
ParameterName = Annotated[str, Field(max_length=64, pattern=r"^[a-z][a-z0-9_.]*$")]


RecordingName = Annotated[str, Field(min_length=1, max_length=255)]
OffsetSeconds = Annotated[float, Field(ge=-MOST_OFFSET_NS / 1e9, le=MOST_OFFSET_NS / 1e9, allow_inf_nan=False)]


class ProcessBody(Body):
    """How a sequence is to be labelled; what is left out is as the paper has it.

    Without `recording_ids` it is made of all registered recordings, and again, by itself, once one is added.
    `clock_offsets_s`, by id or name of recording, are added to its times instead of what is measured.
    """

    model_config = example(
        profile="local",
        parameters={"reference.alpha": 0.05},
        odometry_topic="/novatel/oem7/odom",
    )

    profile: Literal["paper", "local"] = "paper"
    parameters: dict[ParameterName, StrictInt | StrictFloat] = Field(default={}, max_length=64)
    odometry_topic: Literal["kiss-icp"] | Topic | None = None
    lidar_topic: Topic | None = None
    ground: Literal["given", "auto"] = "given"
    stages: list[Literal["synchronise", "label"]] = Field(default=["synchronise", "label"], min_length=1, max_length=2)
    recording_ids: list[IdText] = Field(default=[], max_length=MOST_MEMBERS)
    clock_offsets_s: dict[RecordingName, OffsetSeconds] = Field(
        default={}, max_length=MOST_MEMBERS, examples=[{"cameras.mcap": -0.08}]
    )

    def chosen(self) -> ProcessRequest:
        """The request as the runtime understands it."""
        stages = tuple[str, ...](self.stages)
        topics = (self.odometry_topic, self.lidar_topic)
        chosen = ProcessRequest(self.profile, self.parameters, *topics, stages, ground=self.ground)
        offsets_ns = {name: round(offset_s * 1e9) for name, offset_s in self.clock_offsets_s.items()}
        return replace(chosen, recording_ids=tuple(self.recording_ids), clock_offsets_ns=offsets_ns)


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
