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
    "authorization_pending": ProblemType(400, "The program has not been approved yet"),
    "bad_request": ProblemType(400, "The request cannot be read"),
    "bad_tus_header": ProblemType(400, "A header of the tus protocol is missing or cannot be read"),
    "expired_token": ProblemType(400, "The device code is unknown, has expired or was used"),
    "length_deferred": ProblemType(400, "Upload-Defer-Length is not supported; the length must be known at creation"),
    "sign_in_state": ProblemType(400, "The answer of a provider does not belong to a sign-in that this browser began"),
    "unauthenticated": ProblemType(401, "Not signed in, or the token or session is no longer valid"),
    "wrong_password": ProblemType(401, "The name or the password is wrong"),
    "access_denied": ProblemType(403, "The program was denied, or the approving browser's session has ended"),
    "browser_only": ProblemType(403, "Only a person in a signed-in browser can do this, not a token"),
    "csrf": ProblemType(403, "The request lacks the CSRF token of the browser's session"),
    "forbidden": ProblemType(403, "The caller is known, but their role or token does not allow this"),
    "frames_hidden": ProblemType(403, "Pictures of frames are not shown where the ground truth is hidden"),
    "not_admitted": ProblemType(403, "None of the user's groups is admitted"),
    "joined_upload": ProblemType(403, "An upload that is made of parts takes no bytes of its own"),
    "not_captain": ProblemType(403, "Only the captain may do this"),
    "passwords_off": ProblemType(403, "Password sign-in is disabled"),
    "provider_refused": ProblemType(403, "The provider denied the sign-in"),
    "account_deactivated": ProblemType(403, "The account is deactivated"),
    "splits_forbidden": ProblemType(403, "The draft splits are the administrators'"),
    "withheld": ProblemType(403, "This part of a result is not shown to the caller, or not yet"),
    "alarm_missing": ProblemType(404, "There is no such alarm"),
    "ground_truth_of_other_phase": ProblemType(404, "The ground truth is that of another phase"),
    "hidden_part": ProblemType(404, "The labels of test cannot be downloaded"),
    "no_invitation": ProblemType(404, "The invitation is unknown, used, withdrawn or too old"),
    "no_playback": ProblemType(
        404, "The labels have no playback yet: none was asked for, its job is still at it, or failed"
    ),
    "no_provider": ProblemType(404, "No provider of OpenID Connect is set up here"),
    "no_scene": ProblemType(404, "The labels were made by a release without a viewer"),
    "no_webhook": ProblemType(404, "The user has no webhook"),
    "not_found": ProblemType(404, "Not found, or no access"),
    "not_member": ProblemType(404, "The team has no such member"),
    "predictions_gone": ProblemType(404, "The zip of this submission is not kept any more"),
    "score_missing": ProblemType(404, "Score not found, or no access"),
    "sequence_deleted": ProblemType(404, "The sequence was deleted; nothing more is made of it"),
    "upload_missing": ProblemType(404, "There is no such upload, or it is somebody else's"),
    "upload_target_missing": ProblemType(404, "What the upload is meant for does not exist, or is somebody else's"),
    "method_not_allowed": ProblemType(405, "The route has no such method"),
    "body_too_slow": ProblemType(408, "The body arrived below the minimum rate, or stopped"),
    "receive_timeout": ProblemType(408, "The client sent nothing for too long; what was written before counts"),
    "already_active": ProblemType(409, "The board shows this evaluation version now"),
    "already_in_team": ProblemType(409, "Somebody takes part in the phase with another team already"),
    "already_member": ProblemType(409, "The user is a member of the team"),
    "already_processing": ProblemType(409, "A run is already in progress; `job_id` is that run"),
    "bad_member": ProblemType(409, "A file cannot have this name in an archive"),
    "captain_cannot_leave": ProblemType(409, "The captain cannot leave while there are other members"),
    "conflict": ProblemType(409, "Not possible in the current state"),
    "email_not_verified": ProblemType(409, "The secret of a mailed link does not verify the account's address"),
    "empty_catalogue": ProblemType(409, "There is nothing to divide"),
    "empty_part": ProblemType(409, "The dataset version has no sequence in the part that was asked for"),
    "export_unfinished": ProblemType(409, "The files of an export are there once its job has succeeded"),
    "footprint_off_ground": ProblemType(409, "The ground lies far off the ego origin of the calibration"),
    "hash_mismatch": ProblemType(409, "The uploaded file is not the one that was declared"),
    "held_out_low": ProblemType(409, "A label set has a lower held-out recall than a published version may have"),
    "hidden_truth": ProblemType(409, "Labels that serve as hidden ground truth cannot be made public"),
    "inputs_impossible": ProblemType(409, "A sequence is gone, or what its inputs are made of"),
    "inputs_complete": ProblemType(409, "Every sequence has its inputs already"),
    "last_administrator": ProblemType(409, "The last administrator cannot be removed"),
    "name_taken": ProblemType(409, "Somebody or something else has this name already"),
    "no_calibration": ProblemType(409, "No calibration is assigned"),
    "no_email": ProblemType(409, "The platform sends no e-mail"),
    "no_ground_truth": ProblemType(409, "The phase has no ground truth yet"),
    "no_recording": ProblemType(409, "There is nothing to process, or what there is was refused"),
    "no_splits": ProblemType(409, "No sequence is in the splits yet"),
    "not_as_announced": ProblemType(409, "The file is not the one that the draft of the submission announces"),
    "not_comparable": ProblemType(409, "Two submissions have no score by one ground truth and metric in this phase"),
    "not_scored": ProblemType(409, "The submission has no score that could be shown"),
    "nothing_to_export": ProblemType(409, "The sequence has no labels, or not what an export is made of"),
    "offset_mismatch": ProblemType(
        409, "The client would continue where the file does not end. `offset_bytes` is where it does"
    ),
    "label_set_pinned": ProblemType(409, "An export, a version, a phase or others' view relies on the label set"),
    "open_test": ProblemType(409, "An open phase over test would tell exactly what is hidden"),
    "other_frames": ProblemType(409, "A new ground truth has other frames than the entries of the phase"),
    "phase_closed": ProblemType(409, "The phase takes no submissions now"),
    "phase_ended": ProblemType(
        409, "A hidden phase that has ended told its results by sequence, and is not opened again"
    ),
    "phase_fixed": ProblemType(409, "What a phase evaluates does not change under a ground truth that stands"),
    "queue_draining": ProblemType(409, "The queue accepts no new jobs until it is resumed"),
    "recording_in_use": ProblemType(409, "A run reads the recording now"),
    "recording_pending": ProblemType(409, "A recording is still being read"),
    "recordings_named_alike": ProblemType(409, "Two different recordings have the same name"),
    "reply_not_kept": ProblemType(
        409, "The first request with this Idempotency-Key took effect, but its answer was not kept"
    ),
    "request_in_flight": ProblemType(409, "The first request with this Idempotency-Key is still being worked on"),
    "rescore_incomplete": ProblemType(
        409, "Entries would vanish from the board, since they have no score by the new evaluation version yet"
    ),
    "splits_broken": ProblemType(409, "The splits were good when they were put, and are not any more"),
    "splits_changed": ProblemType(409, "Somebody changed the splits while the version was prepared"),
    "team_full": ProblemType(409, "The team has as many members as it may have"),
    "too_many": ProblemType(409, "Too many teams or invitations"),
    "too_many_open": ProblemType(409, "The team has too many submissions that are not settled"),
    "too_many_uploads": ProblemType(409, "The owner has too many unfinished or unused uploads"),
    "too_many_uploads_of_draft": ProblemType(
        409, "The draft of a submission has more unfinished or unused uploads than it needs"
    ),
    "truth_changed": ProblemType(409, "The active ground truth changed while the frames were compared"),
    "truth_in_making": ProblemType(409, "Another ground truth of the phase is being made"),
    "truth_not_ready": ProblemType(409, "The ground truth has not been made yet"),
    "unknown_recording": ProblemType(
        409, "A recording was asked for that the sequence has not, or that could not be registered"
    ),
    "wrong_state": ProblemType(409, "The state of the job, submission, re-score or alarm does not allow this"),
    "wrong_upload_purpose": ProblemType(409, "The upload was declared to be something else"),
    "wrong_upload_state": ProblemType(409, "The upload is not in a state in which this can be done"),
    "wrong_upload_target": ProblemType(409, "The upload was declared for another sequence"),
    "upload_gone": ProblemType(410, "The upload ended without a file: expired, terminated or failed"),
    "leaderboard_changed": ProblemType(412, "Another evaluation version was activated since the board was read"),
    "precondition_failed": ProblemType(412, "The resource was changed since it was read"),
    "tus_version": ProblemType(412, "Tus-Resumable is missing or not 1.0.0"),
    "body_too_large": ProblemType(413, "The body is larger than the route reads"),
    "over_length": ProblemType(413, "More bytes came than were declared; those of this request were cut off again"),
    "quota_exceeded": ProblemType(413, "The owner would have more than the limit"),
    "submission_too_large": ProblemType(413, "The file is larger than all frames of the phase could be"),
    "too_many_small_requests": ProblemType(
        413, "The upload came in so many small requests that it is not to be kept in as many objects"
    ),
    "upload_too_large": ProblemType(413, "The file is larger than this platform takes"),
    "unsupported_media_type": ProblemType(415, "The body is not of the type that this route reads"),
    "range_not_satisfiable": ProblemType(416, "The range begins behind the end of the file"),
    "DST-070": ProblemType(422, "The class map is not valid"),
    "TOP-113": ProblemType(422, "A topic profile names an unknown role, an impossible topic, or one topic twice"),
    "bad_clock_offset": ProblemType(422, "An offset of a clock is given that belongs to no recording of the run"),
    "bad_cursor": ProblemType(422, "The cursor does not belong to this list"),
    "bad_email_address": ProblemType(422, "Not an e-mail address"),
    "bad_form": ProblemType(422, "The form cannot be read, or does not hold what is expected"),
    "bad_idempotency_key": ProblemType(422, "Invalid Idempotency-Key"),
    "bad_name": ProblemType(422, "A name for a user has characters that would be mistaken for something else"),
    "bad_parameter": ProblemType(422, "A profile or parameter that cannot be chosen, or not with this value"),
    "grids_differ": ProblemType(409, "Labels of two grids cannot be held against each other"),
    "mixed_grids": ProblemType(409, "The labels of a dataset version would have more than one grid"),
    "bad_grid": ProblemType(422, "A grid that is not known, or cannot be one"),
    "bad_phase": ProblemType(422, "The rules of a phase contradict themselves or are out of range"),
    "bad_parts": ProblemType(422, "The uploads cannot be joined to one"),
    "bad_place": ProblemType(422, "Not a path below a root for files in place"),
    "bad_recording_files": ProblemType(422, "The files cannot be one bag"),
    "bad_split_sizes": ProblemType(422, "The sizes of the parts cannot be those of a split"),
    "bad_stages": ProblemType(422, "Stages build on each other, so what is asked for must begin at the first"),
    "bad_team_name": ProblemType(422, "Invalid team name"),
    "bad_upload_metadata": ProblemType(422, "Something said about the file cannot be meant"),
    "bad_webhook_url": ProblemType(422, "The webhook URL is not allowed"),
    "calibration_refused": ProblemType(422, "The calibration is refused; `errors` has the code of the check"),
    "catalogue_too_large": ProblemType(422, "There are more sequences than a proposal is made for"),
    "guessable_password": ProblemType(422, "The password is easy to guess"),
    "idempotency_key_reused": ProblemType(422, "The same Idempotency-Key was sent with another request"),
    "invalid_request": ProblemType(422, "The request does not have the form the route asks for"),
    "reader_crashed": ProblemType(
        422, "Reading the input broke its process or its limits; the same bytes would do so again"
    ),
    "no_archive": ProblemType(422, "A dataset in place is a ZIP or a tar"),
    "not_by_ranges": ProblemType(422, "Only an MCAP file, and a ZIP of a dataset, can be read by ranges from a bucket"),
    "reason_missing": ProblemType(422, "An administrative action needs a reason"),
    "reported_twice": ProblemType(422, "A method stands twice with one modality"),
    "same_label_set": ProblemType(422, "A label set is not compared with itself"),
    "split_refused": ProblemType(422, "The splits break a rule that the data allow"),
    "superseded_metric": ProblemType(422, "By this version nothing is scored anew"),
    "unknown_format": ProblemType(422, "There is no export of this name"),
    "unknown_label_set": ProblemType(422, "The sequence has no such label set"),
    "unknown_metric": ProblemType(422, "No metric has this version"),
    "unknown_root": ProblemType(422, "There is no such root for files in place"),
    "unknown_role": ProblemType(422, "There is no such role"),
    "unstorable_value": ProblemType(422, "A value holds a character or a size that cannot be kept"),
    "weak_password": ProblemType(422, "A password is too short to resist guessing, or too long to be one"),
    "upload_locked": ProblemType(423, "Another request is writing to this upload"),
    "client_too_old": ProblemType(426, "The client's release is no longer supported by this server"),
    "precondition_required": ProblemType(428, "A change needs the ETag of the resource (If-Match)"),
    "guessed_too_often": ProblemType(
        429, "Too many wrong passwords, for this name or from this address: the next try waits"
    ),
    "rate_limited": ProblemType(429, "Too many requests in too short a time"),
    "scorings_exhausted": ProblemType(429, "The team has had as many submissions scored as the phase allows"),
    "slow_down": ProblemType(429, "A program asks for its token more often than it was told to"),
    "too_many_streams": ProblemType(429, "Too many event streams, of the caller or in total"),
    "too_many_verifications": ProblemType(429, "Too many e-mails were sent to verify addresses of one user"),
    "validations_exhausted": ProblemType(
        429, "The team has had as many files checked within a day as the phase allows"
    ),
    "checksum_mismatch": ProblemType(
        460, "The bytes of this request are not those that were sent; they were cut off again"
    ),
    "sha256_mismatch": ProblemType(460, "The whole file is not the declared one; it was removed"),
    "internal_error": ProblemType(500, "A fault of the platform"),
    "object_damaged": ProblemType(500, "A stored file is damaged: the platform's fault"),
    "id_token_refused": ProblemType(502, "The ID token is not one that the provider made for this sign-in"),
    "provider_answer": ProblemType(502, "What the provider answered is not what the standard says"),
    "busy": ProblemType(503, "Too many password checks, waiting programs or request bodies at this moment"),
    "database_unavailable": ProblemType(503, "The database cannot be reached, or is too busy"),
    "provider_unavailable": ProblemType(503, "The provider does not answer, or not in time"),
    "reader_interrupted": ProblemType(
        503, "Reading the input was cut short by the machine; perhaps no fault of the input"
    ),
    "store_unavailable": ProblemType(503, "The store did not answer, or answered that it cannot work now"),
    "disk_full": ProblemType(507, "The disk is full; what was written before is kept"),
    "insufficient_storage": ProblemType(507, "The disk is full; nothing was lost"),
    "storage_full": ProblemType(507, "The disk is full up to its reserve; the new files would not fit"),
    "store_full": ProblemType(507, "The store, or the local cache in front of it, has no room left"),
}
OF_OTHERS = {460: "Checksum Mismatch"}  # statuses that HTTP itself does not know


def phrase_of(status: int) -> str:
    """The status's name."""
    return OF_OTHERS.get(status) or HTTPStatus(status).phrase
