"""Meanings of codes of failed runs, and of warnings about a phase."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning("code_changed", "refused", "Another release of the platform started the run.", "Process again."),
    CodeMeaning(
        "footprint_off_ground",
        "refused",
        "The ground under the footprint lies outside the search band for driven ground, or its tilt shows "
        "that the LiDAR's mount differs from the entered one.",
        "Enter the mount that CAL-433 names, or process with ground auto.",
    ),
    CodeMeaning(
        "labels_are_hidden_elsewhere",
        "wrong",
        "This open phase reveals ground truth that another version hides.",
        "Choose another version, or hide the ground truth.",
    ),
    CodeMeaning(
        "labels_are_public",
        "wrong",
        "Sequences of the hidden phase are in the train or val split of a published version.",
        "Choose another version, or open the ground truth.",
    ),
    CodeMeaning(
        "labels_were_public",
        "wrong",
        "Sequences of the hidden phase are or were public on their own.",
        "Choose other sequences.",
    ),
    CodeMeaning("no_frames", "refused", "No sweep became a frame.", "See SYN-501."),
    CodeMeaning(
        "no_reference",
        "refused",
        "Too few voxels lie under the track to learn the properties of driven ground.",
        "Drive farther; see SYN-501 and CAL-433.",
    ),
    CodeMeaning(
        "off_lattice",
        "refused",
        "Positions are too far from the origin for a map.",
        "Check the pose source.",
    ),
    CodeMeaning(
        "poses_tilted",
        "refused",
        "According to its poses, the robot drives above or below its heading, although the sweeps show level ground.",
        "Enter the INS rotation that the message names; without an INS, correct the pose source.",
    ),
    CodeMeaning(
        "reader_crashed",
        "refused",
        "The process that read the file crashed or exceeded its limits.",
        "Check the file. If the file is intact, report the crash.",
    ),
    CodeMeaning(
        "reader_interrupted", "refused", "The machine stopped the process that read the file.", "Process again."
    ),
    CodeMeaning(
        "recording_changed",
        "refused",
        "The stored bytes differ from the uploaded bytes.",
        "Upload the recording again.",
    ),
    CodeMeaning(
        "recording_changed_in_place",
        "refused",
        "A recording or dataset that is read in place was changed after its registration.",
        "Restore the file, or remove the recording or import and register the file again.",
    ),
    CodeMeaning(
        "recording_file_missing",
        "refused",
        "The worker cannot find the uploaded file.",
        "Ask an administrator to check the store.",
    ),
    CodeMeaning(
        "recording_refused", "refused", "The recording was refused earlier.", "See its findings under Recordings."
    ),
    CodeMeaning(
        "recording_vanished",
        "refused",
        "A recording or dataset in place is outside its root or not readable.",
        "Restore it, or mount the root on every ingest and labeler worker.",
    ),
    CodeMeaning(
        "restarted_too_often",
        "refused",
        "Workers of two releases keep restarting the run alternately.",
        "Ask an administrator to upgrade all workers.",
    ),
    CodeMeaning(
        "root_unavailable",
        "refused",
        "The worker does not have the root folder for files in place.",
        "Mount the folder; the job is retried automatically.",
    ),
    CodeMeaning(
        "work_gone", "refused", "Intermediate results were deleted a week after the run ended.", "Process again."
    ),
    CodeMeaning(
        "worker_lost",
        "refused",
        "The worker stopped sending heartbeats, and no attempt is left.",
        "Process again; an administrator should check memory and the worker's log.",
    ),
)
