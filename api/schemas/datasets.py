"""Versions of the dataset over the wire."""

from typing import Annotated, Any, Literal

from pydantic import Field

from api.schemas.base import SHA256_EXAMPLE, Answer, Body, Instant, Line, Reason, example
from api.schemas.splits import DRIVEN_EXAMPLE, FINDING_EXAMPLE, DrivenItem, RuleItem, Sizes
from services.domain.datasets.input_jobs import InputState

VERSION_PATTERN = "^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
OpenPart = Literal["train", "val"]
PART_EXAMPLE: dict[str, Any] = {
    "part": "train",
    "files": 41203,
    "size_bytes": 1500223311,
    "tar_bytes": 1531002880,
    "tar_sha256": SHA256_EXAMPLE,
}
DATASET_EXAMPLE: dict[str, Any] = {
    "name": "stone-1.0",
    "licence": "CC-BY-NC-SA-4.0",
    "code_version": "71299b6a455d",
    "manifest_sha256": SHA256_EXAMPLE,
    "manifest_bytes": 8120334,
    "sizes": {"train": 31, "val": 7, "test": 5},
    "created_at": "2026-05-03T09:12:44.120000Z",
}


class NewDatasetBody(Body):
    """A version to be made of the splits as they stand. `reason` is kept in the audit log."""

    model_config = example(name="stone-1.0", licence="CC-BY-NC-SA-4.0", reason="first release")

    name: Annotated[str, Field(pattern=VERSION_PATTERN)]
    licence: Line = ""
    reason: Reason


class DatasetItem(Answer):
    """A version as a list shows it; it never changes."""

    model_config = example(**DATASET_EXAMPLE)

    name: str
    licence: str
    code_version: str
    manifest_sha256: str
    manifest_bytes: int
    sizes: Sizes
    created_at: Instant


class DatasetMemberItem(DrivenItem):
    """A sequence of a version, and the part it is in."""

    model_config = example(split="train", **DRIVEN_EXAMPLE)

    split: str


class DatasetPartItem(Answer):
    """A part that can be downloaded; test's labels cannot."""

    model_config = example(**PART_EXAMPLE)

    part: OpenPart
    files: int
    size_bytes: int
    tar_bytes: int
    tar_sha256: str


class DatasetDetail(DatasetItem):
    """A version with its sequences and what can be downloaded of it."""

    model_config = example(**DATASET_EXAMPLE, sequences=[{"split": "train", **DRIVEN_EXAMPLE}], parts=[PART_EXAMPLE])

    sequences: list[DatasetMemberItem]
    parts: list[DatasetPartItem]


class PublishedDataset(DatasetDetail):
    """A version that was published just now, with what the rules warn of."""

    model_config = example(
        **DATASET_EXAMPLE,
        sequences=[{"split": "train", **DRIVEN_EXAMPLE}],
        parts=[PART_EXAMPLE],
        findings=[FINDING_EXAMPLE],
    )

    findings: list[RuleItem]


# Inputs of a dataset version over the wire: the sensor data that is trained on beside its labels.


DATASET_INPUT_EXAMPLE: dict[str, Any] = {
    "name": "n-forest-07",
    "split": "train",
    "state": "ready",
    "files": 13216,
    "size_bytes": 41003421,
    "tar_bytes": 48210432,
    "tar_sha256": SHA256_EXAMPLE,
    "created_at": "2026-05-03T10:33:40Z",
}


class DatasetInputItem(Answer):
    """The inputs of a sequence of train or val; its tar is at `inputs/{name}.tar` once the state is `ready`.

    `missing`: being made, or to be made when an administrator asks. `lost`: sequence or recording were deleted before,
    so there will be none. Of both, sizes are 0 and the sha256 is ''.
    """

    model_config = example(**DATASET_INPUT_EXAMPLE)

    name: str
    split: OpenPart
    state: InputState
    files: int
    size_bytes: int
    tar_bytes: int
    tar_sha256: str
    created_at: Instant | None
