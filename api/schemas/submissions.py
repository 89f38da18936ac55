"""Submissions over the wire: announcement, progress, findings, and the team's quota."""

from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints

from api.schemas.base import ID_EXAMPLE, PLAIN, PROSE, SHA256_EXAMPLE, Answer, Body, IdText, Instant, Reason, example
from api.schemas.jobs import FailureItem
from services.domain.benchmarks.modalities import Modality

LARGEST_BYTES = 2**50
State = Literal["draft", "queued", "scoring", "scored", "valid", "invalid", "failed", "cancelled"]
Kind = Literal["entry", "baseline", "validation"]
Method = Annotated[str, StringConstraints(pattern=PLAIN, min_length=1, max_length=100, strip_whitespace=True)]
Description = Annotated[str, StringConstraints(pattern=PROSE, max_length=20_000)]
Sha256 = Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]

SAID: dict[str, Any] = {"method": "OccFormer-T", "description": "Trained on train only.", "modality": "C+L"}
FILE: dict[str, Any] = {"sha256": SHA256_EXAMPLE, "size_bytes": 41_943_040}


class NewValidationBody(Body):
    """A zip of predictions to come, as it will be: its sha256 and size, and which team sends it.

    `method` is its name on a board, `modality` what it senses with: a sum of C(ameras), L(iDAR) and R(adar).
    """

    model_config = example(team_id=ID_EXAMPLE, **SAID, **FILE)

    team_id: IdText
    method: Method
    description: Description = ""
    modality: Modality
    sha256: Sha256
    size_bytes: Annotated[int, Field(ge=1, le=LARGEST_BYTES)]


class NewSubmissionBody(NewValidationBody):
    """A zip of predictions to be scored. A `baseline` is shown and not ranked; curators and administrators send one,
    and where the ground truth is hidden it costs their team a scoring as an entry does.
    """

    model_config = example(team_id=ID_EXAMPLE, **SAID, **FILE, kind="entry")

    kind: Literal["entry", "baseline"] = "entry"


class FinalizeBody(Body):
    """The complete upload of the announced zip."""

    model_config = example(upload_id=ID_EXAMPLE)

    upload_id: IdText


class SubmissionChangesBody(Body):
    """Changes of the method page; missing and null keys stay. The modality can change only in a draft."""

    model_config = example(method="OccFormer-T v2", description="Trained on train and val.")

    method: Method | None = None
    description: Description | None = None
    modality: Modality | None = None


class VisibilityBody(Body):
    """Whether boards hide the submission, and the reason, which the team sees."""

    model_config = example(hidden=True, reason="trained on the test part")

    hidden: bool
    reason: Reason


class SubmissionProgress(Answer):
    """Progress over the jobs known at present."""

    model_config = example(done=4, total=16)

    done: int
    total: int


class SubmissionItem(Answer):
    """A submission. `queue_position` is how many are before it while it is queued, `progress` how far its run is.

    `state`: draft, queued, scoring, then scored, valid (only checked), invalid, failed, cancelled. `problems_total` is
    null until its file was checked.
    """

    model_config = example(
        kind="entry",
        method="OccFormer-T",
        modality="C+L",
        state="scoring",
        problems_total=0,
        failure=None,
        size_bytes=41_943_040,
        revision=3,
        finalized_at="2026-05-03T09:20:11Z",
        hidden_reason="",
    )

    id: str
    phase_id: str
    team_id: str
    user_id: str
    kind: Kind
    method: str
    modality: str
    state: State
    queue_position: int | None
    progress: SubmissionProgress | None
    problems_total: int | None
    failure: FailureItem | None
    sha256: str
    size_bytes: int
    job_id: str | None
    revision: int
    created_at: Instant
    finalized_at: Instant | None
    settled_at: Instant | None
    withdrawn_at: Instant | None
    hidden_at: Instant | None
    hidden_reason: str


class SubmissionDetail(SubmissionItem):
    """A submission with the text of its method's page, and the upload that was or is on its way for it.

    `expected_s` is in how many seconds it will have ended, judged by the last ones; null when that is not known.
    """

    model_config = example(description=SAID["description"], expected_s=40)

    description: str
    upload_id: str | None
    expected_s: int | None


class FileProblem(Answer):
    """One problem: its file in the zip, and its frame."""

    model_config = example(
        code="label_out_of_range", file="run/a.npz", frame="a", expected="values 0 to 3", actual="value 255"
    )

    code: str
    file: str
    frame: str | None
    expected: str
    actual: str


class ValidationReport(Answer):
    """The problems of the file: the first hundred of `errors_total`; `ok` is null until the file is checked."""

    model_config = example(state="invalid", ok=False, errors_total=1, failure=None)

    submission_id: str
    state: State
    ok: bool | None
    errors: list[FileProblem]
    errors_total: int
    failure: FailureItem | None


class StandingAnswer(Answer):
    """The rights of a team in a phase; null limits are unlimited. `limit` applies to the window of `window_s`, grants
    included.

    `next_slot_at` is the time at which the next submission may be finalised: now, later, or null if never.
    """

    model_config = example(
        limit=3,
        used=1,
        reserved=1,
        total_left=17,
        window_s=604800.0,
        next_slot_at="2026-05-03T09:20:11Z",
        validations_per_day=20,
        validations_left=19,
        next_validation_at="2026-05-03T09:20:11Z",
    )

    phase_id: str
    team_id: str
    limit: int | None
    used: int
    reserved: int
    total_left: int | None
    window_s: float
    next_slot_at: Instant | None
    validations_per_day: int
    validations_left: int
    next_validation_at: Instant | None
