"""Versions of the dataset over the wire."""

from typing import Annotated, Literal

from pydantic import Field

from api.schemas.base import Answer, Body, Instant, Line, Reason, example
from api.schemas.grids import GridItem
from api.schemas.splits import DrivenItem, RuleItem, Sizes
from services.domain.datasets.input_jobs import InputState

VERSION_PATTERN = "^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
OpenPart = Literal["train", "val"]


class NewDatasetBody(Body):
    """A version to be made of the splits as they stand. `reason` is kept in the audit log."""

    model_config = example(name="stone-1.0", licence="CC-BY-NC-SA-4.0", reason="first release")

    name: Annotated[str, Field(pattern=VERSION_PATTERN)]
    licence: Line = ""
    reason: Reason


class DatasetItem(Answer):
    """A version as a list shows it; it never changes."""

    model_config = example(
        name="stone-1.0", licence="CC-BY-NC-SA-4.0", code_version="71299b6a455d", manifest_bytes=8120334
    )

    name: str
    licence: str
    code_version: str
    manifest_sha256: str
    manifest_bytes: int
    sizes: Sizes
    grid: GridItem
    created_at: Instant


class DatasetMemberItem(DrivenItem):
    """A sequence of a version, and its part; the quality is not shown for test."""

    model_config = example(split="train")

    split: str


class DatasetPartItem(Answer):
    """A part that can be downloaded; test's labels cannot."""

    model_config = example(part="train", files=41203, size_bytes=1500223311, tar_bytes=1531002880)

    part: OpenPart
    files: int
    size_bytes: int
    tar_bytes: int
    tar_sha256: str


class DatasetDetail(DatasetItem):
    """A version with its sequences and what can be downloaded of it."""

    model_config = example()

    sequences: list[DatasetMemberItem]
    parts: list[DatasetPartItem]


class PublishedDataset(DatasetDetail):
    """A version that was published just now, with what the rules warn of."""

    model_config = example()

    findings: list[RuleItem]


class DatasetInputItem(Answer):
    """The inputs of a sequence of train or val; its tar is at `inputs/{name}.tar` once the state is `ready`.

    `missing`: in progress, or not requested by an administrator yet. `lost`: the sequence or recording was deleted
    before, so there will be none. For both, sizes are 0 and the sha256 is ''.
    """

    model_config = example(
        name="n-forest-07",
        split="train",
        state="ready",
        files=13216,
        size_bytes=41003421,
        tar_bytes=48210432,
        created_at="2026-05-03T10:33:40Z",
    )

    name: str
    split: OpenPart
    state: InputState
    files: int
    size_bytes: int
    tar_bytes: int
    tar_sha256: str
    created_at: Instant | None
