"""The table of HTTP statuses by error class (RFC 9110, RFC 6585; 423 RFC 4918; 460 tus 1.0).

**Conventions.** The nearest class of a refusal's bases counts. What is not in the table is no refusal but a fault of
ours: 500, with the sentence in the log only. A module that brings refusals brings their lines here.
"""

from http import HTTPStatus

from api import errors as api
from api import errors as files
from api import errors as splits
from api.tus import errors as tus
from services.domain.benchmarks.phases import errors as phases
from services.domain.benchmarks.phases import reported_results
from services.domain.benchmarks.rescores import errors as rescores
from services.domain.benchmarks.submissions import errors as submissions
from services.domain.benchmarks.submissions import result_errors as results
from services.domain.benchmarks.teams import errors as teams
from services.domain.benchmarks.teams import names as team_names
from services.domain.datasets import errors as datasets
from services.domain.datasets import input_jobs as inputs
from services.domain.exports import requests
from services.domain.imports import errors as imports
from services.domain.notifications import errors as notifications
from services.domain.sequences import label_comparisons as comparisons
from services.domain.sequences import processing as choices
from services.domain.sequences import processing_errors as processing
from services.domain.sequences import recordings
from services.domain.viewer import errors as views
from services.runtime.access import errors as access
from services.runtime.access import storage_quota
from services.runtime.jobs import errors as jobs
from services.runtime.oidc import errors as oidc
from services.runtime.sandbox import errors as sandbox
from services.runtime.store import keys as store_keys
from services.runtime.store import pack_reading
from services.runtime.uploads import errors as uploads
from stone.errors import StoneError
from stone.scoring import metric
from stone.splits import splits as splitting
from stone_datasets import file_faults
from stone_files import archives, bag_fingerprint
from stone_recordings.topics import profiles as profiles

STATUS_OF: dict[type[StoneError], int] = {
    api.InvalidRequestError: 422,
    api.BadCursorError: 422,
    api.BadIdempotencyKeyError: 422,
    api.BodyTooLargeError: 413,
    api.ClientTooOldError: 426,
    api.ConflictError: 409,
    api.ForbiddenError: 403,
    api.KeyReusedError: 422,
    api.NotFoundError: 404,
    api.PreconditionFailedError: 412,
    api.PreconditionRequiredError: 428,
    api.RateLimitedError: 429,
    api.ReasonMissingError: 422,
    api.ReplyNotKeptError: 409,
    api.RequestInFlightError: 409,
    api.UnauthenticatedError: 401,
    api.DevicePendingError: 400,
    api.DeviceDeniedError: 403,
    api.DeviceCodeError: 400,
    access.BadNameError: 422,
    access.BusyError: 503,
    access.GuessablePasswordError: 422,
    access.LastAdministratorError: 409,
    access.NameTakenError: 409,
    access.PasswordsOffError: 403,
    access.UnknownRoleError: 422,
    access.WeakPasswordError: 422,
    archives.BadMemberError: 409,
    bag_fingerprint.BadBagFilesError: 422,
    choices.ChoiceError: 422,
    comparisons.SameLabelSetError: 422,
    comparisons.UnknownLabelSetError: 422,
    sandbox.SandboxCrashedError: 422,
    sandbox.SandboxInterruptedError: 503,
    datasets.BrokenSplitsError: 409,
    datasets.HiddenPartError: 404,
    datasets.NoSplitsError: 409,
    datasets.SplitsChangedError: 409,
    pack_reading.ExportUnfinishedError: 409,
    requests.NothingToExportError: 409,
    requests.UnknownExportFormatError: 422,
    files.CalibrationRefusedError: 422,
    files.RangeError: 416,
    file_faults.BadClassMapError: 422,
    imports.SplitsForbiddenError: 403,
    inputs.InputsImpossibleError: 409,
    inputs.InputsStandError: 409,
    oidc.IdTokenRefusedError: 502,
    oidc.NoProviderError: 404,
    oidc.NotAdmittedError: 403,
    oidc.ProviderAnswerError: 502,
    oidc.ProviderAwayError: 503,
    oidc.ProviderRefusedError: 403,
    oidc.ShutOutError: 403,
    oidc.SignInStateError: 400,
    jobs.JobStateError: 409,
    notifications.BadEmailAddressError: 422,
    notifications.BadWebhookUrlError: 422,
    notifications.EmailVerificationError: 409,
    notifications.NoEmailError: 409,
    notifications.NoWebhookError: 404,
    notifications.TooManyVerificationsError: 429,
    jobs.QueueDrainingError: 409,
    phases.BadPhaseError: 422,
    phases.EmptyPartError: 409,
    phases.FramesUncomparedError: 409,
    phases.NoGroundTruthError: 409,
    phases.OpenTestError: 409,
    phases.OtherFramesError: 409,
    phases.PhaseEndedError: 409,
    phases.PhaseFixedError: 409,
    phases.TruthInMakingError: 409,
    processing.AlreadyProcessingError: 409,
    processing.ClockOffsetError: 422,
    processing.NoCalibrationError: 409,
    processing.NoRecordingError: 409,
    processing.RecordingNamesError: 409,
    processing.RecordingPendingError: 409,
    processing.SequenceDeletedError: 404,
    processing.UnknownRecordingError: 409,
    processing.UnknownStagesError: 422,
    profiles.BadProfileError: 422,
    recordings.ForeignTargetError: 409,
    reported_results.ReportedTwiceError: 422,
    recordings.RecordingInUseError: 409,
    rescores.AlarmDismissedError: 409,
    rescores.AlarmMissingError: 404,
    rescores.AlreadyActiveError: 409,
    rescores.BoardMovedError: 412,
    rescores.ForeignTruthError: 404,
    rescores.RescoreIncompleteError: 409,
    rescores.RescoreStateError: 409,
    rescores.TruthNotReadyError: 409,
    storage_quota.QuotaExceededError: 413,
    results.FramesHiddenError: 403,
    results.NotComparableError: 409,
    results.NotScoredError: 409,
    results.PredictionsGoneError: 404,
    results.ScoreMissingError: 404,
    results.WithheldError: 403,
    submissions.ExhaustedError: 429,
    submissions.HashMismatchError: 409,
    submissions.PhaseClosedError: 409,
    submissions.SubmissionStateError: 409,
    submissions.SubmissionTooLargeError: 413,
    submissions.TooManyOpenError: 409,
    splits.SplitRefusedError: 422,
    metric.UnknownMetricError: 422,
    metric.SupersededMetricError: 422,
    splitting.BadSizesError: 422,
    splitting.CatalogueTooLargeError: 422,
    splitting.EmptyCatalogueError: 409,
    store_keys.StoreAwayError: 503,
    store_keys.StoreFullError: 507,
    team_names.BadTeamNameError: 422,
    teams.AlreadyInTeamError: 409,
    teams.AlreadyMemberError: 409,
    teams.CaptainStaysError: 409,
    teams.InvitationError: 404,
    teams.NotCaptainError: 403,
    teams.NotMemberError: 404,
    teams.TeamFullError: 409,
    teams.TooManyError: 409,
    tus.ExtensionError: 400,
    tus.FormError: 422,
    tus.LengthDeferredError: 400,
    tus.ReceiveTimeoutError: 408,
    tus.TusHeaderError: 400,
    tus.TusVersionError: 412,
    tus.UnsupportedMediaTypeError: 415,
    views.NoPlaybackError: 404,
    views.NoSceneError: 404,
    uploads.BadMetadataError: 422,
    uploads.ChecksumMismatchError: 460,
    uploads.DiskFullError: 507,
    uploads.FileMismatchError: 460,
    uploads.OffsetMismatchError: 409,
    uploads.OverLengthError: 413,
    uploads.TooManyUploadPartsError: 413,
    uploads.TooManyUploadsError: 409,
    uploads.TooManyUploadsOfDraftError: 409,
    uploads.UndeclaredUploadError: 409,
    uploads.UploadGoneError: 410,
    uploads.UploadLockedError: 423,
    uploads.UploadMissingError: 404,
    uploads.UploadPurposeError: 409,
    uploads.UploadStateError: 409,
    uploads.UploadTargetMissingError: 404,
    uploads.UploadTooLargeError: 413,
}
OF_OTHERS = {460: "Checksum Mismatch"}  # statuses that HTTP itself does not know


def status_of(refusal: type[StoneError]) -> int:
    """The status of the nearest class in the table; 500 where there is none."""
    return next((STATUS_OF[base] for base in refusal.__mro__ if base in STATUS_OF), 500)


def phrase_of(status: int) -> str:
    """The status's name."""
    return OF_OTHERS.get(status) or HTTPStatus(status).phrase
