"""The rows: names, states and keys of things, never arrays. One module per noun; `Base.metadata` knows them all."""

from services.runtime.orm.artefacts import Artefact, Blob, LabelledFrame, LabelSet, LooseObject
from services.runtime.orm.base import Base, new_id
from services.runtime.orm.benchmarks import (
    Activation,
    Benchmark,
    GroundTruth,
    Phase,
    PhaseInput,
    PhaseInputPack,
    Reported,
    Rescore,
)
from services.runtime.orm.books import AuditAnchor, AuditEntry, IdempotentReply, QuotaEntry
from services.runtime.orm.datasets import Dataset, DatasetMember, DatasetPack, DatasetPart, SplitMember, Splits
from services.runtime.orm.exports import Export, ExportPack
from services.runtime.orm.holds import CollectionHold
from services.runtime.orm.jobs import Job, JobAttempt, JobLine, JobNeed, Queue, Worker
from services.runtime.orm.people import SignInGuess, Team, TeamInvitation, TeamMember, Token, User, WebSession
from services.runtime.orm.recordings import Preview, Recording, RecordingFile
from services.runtime.orm.sequences import Calibration, Profile, Sequence, Upload
from services.runtime.orm.slabs import UploadSlab
from services.runtime.orm.submissions import Alarm, PhaseTeam, Score, ScorePart, ScoringEntry, Submission
from services.runtime.orm.telemetry import ChoreRow, Figure, Tally

__all__ = [
    "Activation",
    "Alarm",
    "Artefact",
    "AuditAnchor",
    "AuditEntry",
    "Base",
    "Benchmark",
    "Blob",
    "Calibration",
    "ChoreRow",
    "CollectionHold",
    "Dataset",
    "DatasetMember",
    "DatasetPack",
    "DatasetPart",
    "Export",
    "ExportPack",
    "Figure",
    "GroundTruth",
    "IdempotentReply",
    "Job",
    "JobAttempt",
    "JobLine",
    "JobNeed",
    "LabelSet",
    "LabelledFrame",
    "LooseObject",
    "Phase",
    "PhaseInput",
    "PhaseInputPack",
    "PhaseTeam",
    "Preview",
    "Profile",
    "Queue",
    "QuotaEntry",
    "Recording",
    "RecordingFile",
    "Reported",
    "Rescore",
    "Score",
    "ScorePart",
    "ScoringEntry",
    "Sequence",
    "SignInGuess",
    "SplitMember",
    "Splits",
    "Submission",
    "Tally",
    "Team",
    "TeamInvitation",
    "TeamMember",
    "Token",
    "Upload",
    "UploadSlab",
    "User",
    "WebSession",
    "Worker",
    "new_id",
]
