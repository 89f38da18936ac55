"""Permitted answers of the sandboxed children of a labelling run.

**Conventions.** The author of the bag may control a child: names stay within the folder, numbers are whole and bounded,
kinds are known, and other content is rejected (`services/runtime/sandbox/answers.py`).
"""

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, StringConstraints, field_validator, model_validator

from services.labeler.pipeline import PUBLISH, STAGES
from services.runtime.jobs.specs import JobSpec
from services.runtime.sandbox.answers import Hex256, SandboxAnswer
from stone.errors import Refused
from stone.splits.drives import MOST_PLACES
from stone_base.codes.catalogue import CATALOGUE
from stone_base.label_grid import record_unless_paper, recorded_grid

KINDS = frozenset((*STAGES, PUBLISH))
MOST_JOBS, MOST_FRAMES = 100_000, 2_000_000
LONGEST_WORD = 200
Count = Annotated[int, Field(ge=0, lt=2**63)]
Stamp = Annotated[int, Field(ge=-(2**63), lt=2**63)]
Place = Annotated[int, Field(ge=-(2**31), lt=2**31)]
SEGMENT = r"[A-Za-z0-9_\-][A-Za-z0-9_.\-]*"  # no leading dot: no hidden files, no parent folders
Name = Annotated[str, StringConstraints(pattern=rf"\A{SEGMENT}(/{SEGMENT})*/?\z", max_length=300)]
Token = Annotated[str, StringConstraints(pattern=r"\A[0-9a-f]{32}\z")]
Fact = Count | float | bool | Annotated[str, StringConstraints(max_length=200)]
FACTS = frozenset({"frames", "points", "tiles", "tile", "triangles", "driven", "voxels", "is_floored", "pack_bytes"})
Range = tuple[Count, Count, Hex256]


class JobAnswer(SandboxAnswer):
    """A job of the run, as `JobSpec`: its arguments are whole numbers."""

    expected: ClassVar[str] = "a job"
    kind: str
    arguments: dict[Literal["part", "tile"], Place | tuple[Place, Place] | tuple[Place, Place, Place]]
    key: Annotated[str, StringConstraints(max_length=100)]
    needs: tuple[str, ...]

    @field_validator("kind")
    @classmethod
    def _is_known(cls, kind: str) -> str:
        if kind not in KINDS:
            raise ValueError("unknown kind of job")
        return kind

    def spec(self) -> JobSpec:
        return JobSpec(self.kind, {str(name): value for name, value in self.arguments.items()}, self.key, self.needs)


class GraphAnswer(SandboxAnswer):
    """All the jobs of a run; each needs only earlier jobs."""

    expected: ClassVar[str] = "the jobs of a run"
    jobs: Annotated[list[JobAnswer], Field(max_length=MOST_JOBS)]
    parts: Count
    tiles: Count

    @model_validator(mode="after")
    def _ends(self) -> Self:
        known = set[str]()
        for job in self.jobs:
            if not known.issuperset(job.needs) or (job.key and job.key in known):
                raise ValueError("a job needs a later or unknown job, or is listed twice")
            known.add(job.key)
        return self


class FilesAnswer(SandboxAnswer):
    """Names of files that a job reads."""

    expected: ClassVar[str] = "names of files"
    names: tuple[Name, ...]


class WorkAnswer(SandboxAnswer):
    """The result for a job's row, the facts for its log, and the files that the job wrote."""

    expected: ClassVar[str] = "the result of a job"
    written: tuple[Name, ...]
    result: dict[str, Count]
    facts: dict[str, Fact]

    @field_validator("result", "facts")
    @classmethod
    def _are_known(cls, facts: dict[str, Fact]) -> dict[str, Fact]:
        if not FACTS.issuperset(facts):
            raise ValueError("unknown fact or result")
        return facts


class TrackAnswer(SandboxAnswer):
    """The time and place of a sequence's drive, as `stone.splits.drives.DrivenTrack`."""

    expected: ClassVar[str] = "a track"
    log: Annotated[str, StringConstraints(max_length=LONGEST_WORD)]
    vehicle: Annotated[str, StringConstraints(max_length=LONGEST_WORD)]
    map: Annotated[str, StringConstraints(max_length=LONGEST_WORD + 20)]
    first_ns: Stamp
    last_ns: Stamp
    period_ns: Count
    speed_m_s: Annotated[float, Field(ge=0.0)]
    places: Annotated[tuple[tuple[float, float, float, float], ...], Field(min_length=1, max_length=MOST_PLACES + 2)]


class TotalsAnswer(SandboxAnswer):
    """Totals and quality of a label set, by the names of its row's columns."""

    expected: ClassVar[str] = "totals"
    duration_ns: Count
    distance_m: Annotated[float, Field(ge=0.0)]
    free_voxels: Count
    t_voxels: Count
    p_voxels: Count
    n_voxels: Count
    held_out_recall: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    held_out_m: Annotated[float, Field(ge=0.0)] | None = None
    gravest_code: str | None = None
    gravest_severity: Literal["info", "warning", "error"] | None = None
    track: TrackAnswer | None = None

    @field_validator("gravest_code")
    @classmethod
    def _has_a_meaning(cls, code: str | None) -> str | None:
        if code is not None and code not in CATALOGUE:
            raise ValueError("unknown finding code")
        return code


class PackAnswer(SandboxAnswer):
    """A pack of labels: its file, the ordinal of its first frame, and (offset, length, sha256) of each."""

    expected: ClassVar[str] = "a pack"
    name: Annotated[str, StringConstraints(pattern=r"\Apacks/[0-9]{6,}\.pack\z")]
    first: Count
    ranges: list[Range]

    @property
    def size_bytes(self) -> int:
        offset, length, _ = self.ranges[-1] if self.ranges else (0, 0, "")
        return offset + length


class PublicationAnswer(SandboxAnswer):
    """The rows of a finished run: its frames in order, its packs and totals.

    `grid` is the record of the grid of imported labels, None for the paper's grid.
    """

    expected: ClassVar[str] = "the rows to publish"
    tokens: Annotated[list[Token], Field(max_length=MOST_FRAMES)]
    stamps_ns: list[Stamp]
    packs: list[PackAnswer]
    totals: TotalsAnswer
    grid: dict[str, Any] | None = None

    @field_validator("grid")
    @classmethod
    def _is_a_grid(cls, record: dict[str, Any] | None) -> dict[str, Any] | None:
        try:
            return record_unless_paper(recorded_grid(record))
        except Refused as error:
            raise ValueError(str(error)) from error

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        if len(self.tokens) != len(self.stamps_ns) or len(set(self.tokens)) != len(self.tokens):
            raise ValueError("the number of stamps differs from the number of frames, or a frame is listed twice")
        first = 0
        for pack in self.packs:
            if pack.first != first:
                raise ValueError("packs are not consecutive")
            first += len(pack.ranges)
        if first != len(self.tokens):
            raise ValueError("the number of labels differs from the number of frames")
        return self

    def frame(self, ordinal: int) -> dict[str, Any]:
        """Return the columns that identify a frame."""
        return {"ordinal": ordinal, "token": self.tokens[ordinal], "stamp_ns": self.stamps_ns[ordinal]}
