"""The problem types: the HTTP status and the title of every code that the API answers with.

**Conventions.** Statuses are of RFC 9110, RFC 6585, RFC 4918 (423) and tus 1.0 (460). A code that the table lacks is
a fault of the platform: 500, and its sentence goes only to the log. A new refusal needs a line here.
"""

from http import HTTPStatus
from typing import NamedTuple


class ProblemType(NamedTuple):
    """The status and the title of a code."""

    status: int
    title: str


PROBLEM_TYPES = {
    "authorization_pending": ProblemType(400, "The login request has not been approved yet"),
    "bad_request": ProblemType(400, "Malformed request"),
    "bad_tus_header": ProblemType(400, "A tus header is missing or malformed"),
    "expired_token": ProblemType(400, "The device code is unknown, expired or already used"),
    "length_deferred": ProblemType(
        400, "Upload-Defer-Length is not supported; send the length when you create the upload"
    ),
    "sign_in_state": ProblemType(400, "The provider's response does not belong to a sign-in that this browser started"),
    "unauthenticated": ProblemType(401, "Not signed in, or the token or session is no longer valid"),
    "wrong_password": ProblemType(401, "Wrong name or password"),
    "access_denied": ProblemType(403, "The login request was denied, or the approving browser session has ended"),
    "browser_only": ProblemType(403, "This action requires a signed-in browser; tokens cannot do it"),
    "csrf": ProblemType(403, "The request lacks the CSRF token of the browser's session"),
    "forbidden": ProblemType(403, "The caller's role or token scopes do not allow this"),
    "frames_hidden": ProblemType(403, "Frames are not shown while the ground truth is hidden"),
    "not_admitted": ProblemType(403, "None of the user's groups is admitted"),
    "joined_upload": ProblemType(403, "A joined upload accepts no bytes; send the bytes to its parts"),
    "not_captain": ProblemType(403, "Only the captain can do this"),
    "passwords_off": ProblemType(403, "Password sign-in is disabled"),
    "provider_refused": ProblemType(403, "The provider denied the sign-in"),
    "account_deactivated": ProblemType(403, "The account is deactivated"),
    "splits_forbidden": ProblemType(403, "Only administrators can change the draft splits"),
    "withheld": ProblemType(403, "The caller cannot see this part of the result, or not yet"),
    "alarm_missing": ProblemType(404, "Alarm not found"),
    "ground_truth_of_other_phase": ProblemType(404, "The ground truth belongs to another phase"),
    "hidden_part": ProblemType(404, "The labels of the test split cannot be downloaded"),
    "no_invitation": ProblemType(404, "The invitation is unknown, used, withdrawn or expired"),
    "no_playback": ProblemType(404, "No playback: none was requested, its job is unfinished, or its job failed"),
    "no_provider": ProblemType(404, "No OpenID Connect provider is configured"),
    "no_scene": ProblemType(404, "The labels have no 3D scene: the release that made them had no viewer"),
    "no_webhook": ProblemType(404, "The user has no webhook"),
    "not_found": ProblemType(404, "Not found, or no access"),
    "not_member": ProblemType(404, "The user is not a member of the team"),
    "predictions_gone": ProblemType(404, "The zip of this submission was deleted"),
    "score_missing": ProblemType(404, "Score not found, or no access"),
    "sequence_deleted": ProblemType(404, "The sequence was deleted and cannot be processed"),
    "upload_missing": ProblemType(404, "Upload not found, or no access"),
    "upload_target_missing": ProblemType(404, "Upload target not found, or no access"),
    "method_not_allowed": ProblemType(405, "The route does not support this method"),
    "body_too_slow": ProblemType(408, "The body arrived below the minimum rate or stopped"),
    "receive_timeout": ProblemType(408, "The client sent nothing for too long; the bytes received are kept"),
    "already_active": ProblemType(409, "The board already shows this evaluation version"),
    "already_in_team": ProblemType(409, "A member already takes part in the phase with another team"),
    "already_member": ProblemType(409, "The user is already a member of the team"),
    "already_processing": ProblemType(409, "A run is already in progress; `job_id` names it"),
    "bad_member": ProblemType(409, "The file name is not allowed in an archive"),
    "captain_cannot_leave": ProblemType(409, "The captain cannot leave while there are other members"),
    "conflict": ProblemType(409, "The current state does not allow this"),
    "email_not_verified": ProblemType(409, "The secret of the mailed link does not verify this address"),
    "empty_catalogue": ProblemType(409, "There are no sequences to divide into splits"),
    "empty_part": ProblemType(409, "The dataset version has no sequence in the requested split"),
    "export_unfinished": ProblemType(409, "The export has no files yet because its job has not succeeded"),
    "footprint_off_ground": ProblemType(409, "The ground is too far above or below the ego origin of the calibration"),
    "hash_mismatch": ProblemType(409, "The uploaded file differs from the declared SHA-256"),
    "held_out_low": ProblemType(409, "The held-out recall of a label set is below the minimum for a published version"),
    "hidden_truth": ProblemType(409, "Labels that serve as hidden ground truth cannot be made public"),
    "inputs_impossible": ProblemType(409, "A sequence, or data that its inputs require, no longer exists"),
    "inputs_complete": ProblemType(409, "Every sequence already has its inputs"),
    "last_administrator": ProblemType(409, "The last administrator cannot be removed"),
    "name_taken": ProblemType(409, "The name is already in use"),
    "no_calibration": ProblemType(409, "No calibration is assigned"),
    "no_email": ProblemType(409, "E-mail is not configured on this platform"),
    "no_ground_truth": ProblemType(409, "The phase has no ground truth yet"),
    "no_recording": ProblemType(409, "The sequence has no recording that can be processed"),
    "no_splits": ProblemType(409, "The draft splits contain no sequence"),
    "not_as_announced": ProblemType(409, "The file differs from the one announced in the draft submission"),
    "not_comparable": ProblemType(409, "The two submissions share no ground truth and metric in this phase"),
    "not_scored": ProblemType(409, "The submission has no visible score"),
    "nothing_to_export": ProblemType(409, "The sequence has no labels, or lacks data that the export requires"),
    "offset_mismatch": ProblemType(
        409, "Upload-Offset does not match. The server has `offset_bytes` bytes; resume from there"
    ),
    "label_set_pinned": ProblemType(409, "An export, a version, a phase or another user's view requires the label set"),
    "open_test": ProblemType(409, "An open phase on the test split would reveal the hidden labels"),
    "other_frames": ProblemType(409, "The frames of the new ground truth differ from those of the phase's entries"),
    "phase_closed": ProblemType(409, "The phase does not accept submissions at this time"),
    "phase_ended": ProblemType(
        409, "An ended hidden phase has revealed its results by sequence and cannot be reopened"
    ),
    "phase_fixed": ProblemType(409, "The evaluated data of a phase cannot change while it has an active ground truth"),
    "queue_draining": ProblemType(409, "The queue accepts no new jobs until it is resumed"),
    "recording_in_use": ProblemType(409, "A run is reading the recording"),
    "recording_pending": ProblemType(409, "A recording has not been registered yet"),
    "recordings_named_alike": ProblemType(409, "Two different recordings have the same name"),
    "reply_not_kept": ProblemType(
        409, "The first request with this Idempotency-Key took effect, but its response was not kept"
    ),
    "request_in_flight": ProblemType(409, "The first request with this Idempotency-Key is still in progress"),
    "rescore_incomplete": ProblemType(
        409, "Entries without a score by the new evaluation version would vanish from the board"
    ),
    "splits_broken": ProblemType(409, "The draft splits were valid when they were saved and have become invalid"),
    "splits_changed": ProblemType(409, "The draft splits changed while the version was prepared"),
    "team_full": ProblemType(409, "The team has reached its maximum number of members"),
    "too_many": ProblemType(409, "Too many teams or invitations"),
    "too_many_open": ProblemType(409, "The team has too many unfinished submissions"),
    "too_many_uploads": ProblemType(409, "The owner has too many unfinished or unused uploads"),
    "too_many_uploads_of_draft": ProblemType(
        409, "The draft submission has more unfinished or unused uploads than it needs"
    ),
    "truth_changed": ProblemType(409, "The active ground truth changed while the frames were compared"),
    "truth_in_making": ProblemType(409, "Another ground truth of the phase is being created"),
    "truth_not_ready": ProblemType(409, "The ground truth is not ready yet"),
    "unknown_recording": ProblemType(409, "The sequence has no such recording, or the recording failed to register"),
    "wrong_state": ProblemType(409, "The state of the job, submission, re-score or alarm does not allow this"),
    "wrong_upload_purpose": ProblemType(409, "The upload was created for another purpose"),
    "wrong_upload_state": ProblemType(409, "The state of the upload does not allow this"),
    "wrong_upload_target": ProblemType(409, "The upload was created for another sequence"),
    "upload_gone": ProblemType(410, "The upload expired, failed or was terminated"),
    "leaderboard_changed": ProblemType(412, "Another evaluation version was activated after the board was read"),
    "precondition_failed": ProblemType(412, "The resource has changed since it was read"),
    "tus_version": ProblemType(412, "Tus-Resumable is missing or not 1.0.0"),
    "body_too_large": ProblemType(413, "The body exceeds the limit of this route"),
    "over_length": ProblemType(413, "The request exceeded the declared length; its bytes were discarded"),
    "quota_exceeded": ProblemType(413, "The owner would exceed the quota"),
    "submission_too_large": ProblemType(413, "The file is larger than all frames of the phase could be"),
    "too_many_small_requests": ProblemType(413, "Too many small requests for one upload; send larger ones"),
    "upload_too_large": ProblemType(413, "The file exceeds the platform's size limit"),
    "unsupported_media_type": ProblemType(415, "The route does not accept this Content-Type"),
    "range_not_satisfiable": ProblemType(416, "The range starts after the end of the file"),
    "DST-070": ProblemType(422, "Invalid class map"),
    "TOP-113": ProblemType(422, "A topic profile has an unknown role, an invalid topic or a repeated topic"),
    "bad_clock_offset": ProblemType(422, "A clock offset belongs to no recording of the run"),
    "bad_cursor": ProblemType(422, "The cursor does not belong to this list"),
    "bad_email_address": ProblemType(422, "Invalid e-mail address"),
    "bad_form": ProblemType(422, "Malformed form, or unexpected fields"),
    "bad_idempotency_key": ProblemType(422, "Invalid Idempotency-Key"),
    "bad_name": ProblemType(422, "A user name contains characters that can be confused with others"),
    "bad_parameter": ProblemType(422, "Unknown profile or parameter, or invalid value"),
    "grids_differ": ProblemType(409, "Label sets on different grids cannot be compared"),
    "mixed_grids": ProblemType(409, "The label sets of a dataset version must have the same grid"),
    "bad_grid": ProblemType(422, "Unknown or invalid grid"),
    "bad_phase": ProblemType(422, "The settings of a phase contradict each other or are out of range"),
    "bad_parts": ProblemType(422, "The uploads cannot be joined"),
    "bad_place": ProblemType(422, "Invalid path below the root"),
    "bad_recording_files": ProblemType(422, "The files do not form one bag"),
    "bad_split_sizes": ProblemType(422, "Invalid split sizes"),
    "bad_stages": ProblemType(
        422, "The requested stages must start with the first, because each requires the previous one"
    ),
    "bad_team_name": ProblemType(422, "Invalid team name"),
    "bad_upload_metadata": ProblemType(422, "Invalid Upload-Metadata"),
    "bad_webhook_url": ProblemType(422, "The webhook URL is not allowed"),
    "calibration_refused": ProblemType(422, "Invalid calibration; `errors` has the code of the check"),
    "catalogue_too_large": ProblemType(422, "Too many sequences for a split proposal"),
    "guessable_password": ProblemType(422, "The password is easy to guess"),
    "idempotency_key_reused": ProblemType(422, "The Idempotency-Key was already used for a different request"),
    "invalid_request": ProblemType(422, "Invalid request; `errors` lists the fields"),
    "reader_crashed": ProblemType(422, "The reader crashed on this input or exceeded its limits"),
    "no_archive": ProblemType(422, "A dataset in place must be a ZIP or a tar"),
    "not_by_ranges": ProblemType(
        422, "Only an MCAP file or the ZIP of a dataset can be read from a bucket without an upload"
    ),
    "reason_missing": ProblemType(422, "An administrative action requires a reason"),
    "reported_twice": ProblemType(422, "The table lists a method twice with the same modality"),
    "same_label_set": ProblemType(422, "A label set cannot be compared with itself"),
    "split_refused": ProblemType(422, "The splits break a rule that the data can satisfy"),
    "superseded_metric": ProblemType(422, "The metric version is superseded and cannot be used for new scores"),
    "unknown_format": ProblemType(422, "Unknown export format"),
    "unknown_label_set": ProblemType(422, "The sequence has no such label set"),
    "unknown_metric": ProblemType(422, "Unknown metric version"),
    "unknown_root": ProblemType(422, "Unknown root"),
    "unknown_role": ProblemType(422, "Unknown role"),
    "unstorable_value": ProblemType(422, "A value has an unsupported character or size"),
    "weak_password": ProblemType(422, "The password is too short or too long"),
    "upload_locked": ProblemType(423, "Another request is writing to this upload"),
    "client_too_old": ProblemType(426, "The server no longer supports this client release"),
    "precondition_required": ProblemType(428, "A change requires the ETag of the resource (If-Match)"),
    "guessed_too_often": ProblemType(
        429, "Too many wrong passwords for this name or from this address; wait before you try again"
    ),
    "rate_limited": ProblemType(429, "Too many requests in too short a time"),
    "scorings_exhausted": ProblemType(429, "The team has used all scored submissions that the phase allows"),
    "slow_down": ProblemType(429, "The client polls for its token faster than allowed"),
    "too_many_streams": ProblemType(429, "Too many event streams, of the caller or in total"),
    "too_many_verifications": ProblemType(429, "Too many verification e-mails for one user"),
    "validations_exhausted": ProblemType(429, "The team has used all validations that the phase allows in 24 hours"),
    "checksum_mismatch": ProblemType(460, "The request's bytes do not match Upload-Checksum and were discarded"),
    "sha256_mismatch": ProblemType(460, "The file does not match the declared SHA-256 and was deleted"),
    "internal_error": ProblemType(500, "Internal error of the platform"),
    "object_damaged": ProblemType(500, "A stored file of the platform is damaged"),
    "id_token_refused": ProblemType(502, "The provider's ID token is not valid for this sign-in"),
    "provider_answer": ProblemType(502, "The provider's response does not conform to OpenID Connect"),
    "busy": ProblemType(503, "Too many password checks, pending logins or request bodies"),
    "database_unavailable": ProblemType(503, "The database is unreachable or too busy"),
    "provider_unavailable": ProblemType(503, "The provider did not respond in time"),
    "reader_interrupted": ProblemType(
        503, "Reading the input was interrupted by the machine, possibly not by the input"
    ),
    "store_unavailable": ProblemType(503, "The store did not respond or is unavailable"),
    "disk_full": ProblemType(507, "The disk is full; the bytes received are kept"),
    "insufficient_storage": ProblemType(507, "The disk is full; nothing was lost"),
    "storage_full": ProblemType(507, "The new files would exceed the disk's reserve"),
    "store_full": ProblemType(507, "The store or its local cache is full"),
}
OF_OTHERS = {460: "Checksum Mismatch"}  # statuses missing in http.HTTPStatus


def phrase_of(status: int) -> str:
    """Return the status's name."""
    return OF_OTHERS.get(status) or HTTPStatus(status).phrase
