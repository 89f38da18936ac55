"""The ORM models, one module per noun; `Base.metadata` knows them all."""

from services.runtime.orm.artefacts import Artefact, Blob, LabelledFrameRow, LabelSet, LooseObject
from services.runtime.orm.base import Base, new_id
from services.runtime.orm.benchmarks import (
    Activation,
    Benchmark,
    GroundTruthRow,
    Phase,
    PhaseInput,
    PhaseInputPack,
    Reported,
    Rescore,
)
from services.runtime.orm.dataset_imports import DatasetImport, ImportedFile
from services.runtime.orm.datasets import (
    Dataset,
    DatasetInput,
    DatasetInputPack,
    DatasetMember,
    DatasetPack,
    DatasetPart,
    SplitMember,
    Splits,
)
from services.runtime.orm.exports import Export, ExportPack
from services.runtime.orm.gc_holds import GcHoldRow
from services.runtime.orm.jobs import Job, JobAttempt, JobLine, JobNeed, Queue, Worker
from services.runtime.orm.label_comparisons import LabelComparison
from services.runtime.orm.ledgers import AuditAnchor, AuditEntry, IdempotentReply, QuotaEntry
from services.runtime.orm.notifications import (
    EmailAddress,
    NotificationChoice,
    NotificationDelivery,
    NotificationEvent,
    Webhook,
)
from services.runtime.orm.people import (
    FailedSignInRow,
    SignInAddress,
    Team,
    TeamInvitation,
    TeamMember,
    Token,
    User,
    WebSession,
)
from services.runtime.orm.recordings import Preview, Recording, RecordingFile
from services.runtime.orm.sequences import CalibrationRow, ProfileRow, SequenceRow, Upload
from services.runtime.orm.sign_in import DeviceGrant, ExternalIdentity
from services.runtime.orm.submissions import Alarm, PhaseTeam, Score, ScorePart, ScoringEntry, SubmissionRow
from services.runtime.orm.telemetry import ChoreRow, CounterRow, FigureRow
from services.runtime.orm.upload_parts import UploadPartRow

__all__ = [
    "Activation",
    "Alarm",
    "Artefact",
    "AuditAnchor",
    "AuditEntry",
    "Base",
    "Benchmark",
    "Blob",
    "CalibrationRow",
    "ChoreRow",
    "CounterRow",
    "Dataset",
    "DatasetImport",
    "DatasetInput",
    "DatasetInputPack",
    "DatasetMember",
    "DatasetPack",
    "DatasetPart",
    "DeviceGrant",
    "EmailAddress",
    "Export",
    "ExportPack",
    "ExternalIdentity",
    "FailedSignInRow",
    "FigureRow",
    "GcHoldRow",
    "GroundTruthRow",
    "IdempotentReply",
    "ImportedFile",
    "Job",
    "JobAttempt",
    "JobLine",
    "JobNeed",
    "LabelComparison",
    "LabelSet",
    "LabelledFrameRow",
    "LooseObject",
    "NotificationChoice",
    "NotificationDelivery",
    "NotificationEvent",
    "Phase",
    "PhaseInput",
    "PhaseInputPack",
    "PhaseTeam",
    "Preview",
    "ProfileRow",
    "Queue",
    "QuotaEntry",
    "Recording",
    "RecordingFile",
    "Reported",
    "Rescore",
    "Score",
    "ScorePart",
    "ScoringEntry",
    "SequenceRow",
    "SignInAddress",
    "SplitMember",
    "Splits",
    "SubmissionRow",
    "Team",
    "TeamInvitation",
    "TeamMember",
    "Token",
    "Upload",
    "UploadPartRow",
    "User",
    "WebSession",
    "Webhook",
    "Worker",
    "new_id",
]
