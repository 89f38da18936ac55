"""Meanings of codes of failed runs, and of warnings about a phase."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning("code_changed", "refused", "The run was begun by another release of the platform.", "Process again."),
    CodeMeaning(
        "footprint_off_ground",
        "refused",
        "The ground lies farther from the footprint than the band in which driven ground is looked for, or the LiDAR "
        "is mounted otherwise than entered, by the tilt of the ground.",
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
        "Sequences of the hidden phase are in train or val of a published version.",
        "Choose another version, or open the ground truth.",
    ),
    CodeMeaning(
        "labels_were_public",
        "wrong",
        "Sequences of the hidden phase are or were public by themselves.",
        "Choose other sequences.",
    ),
    CodeMeaning("no_frames", "refused", "No sweep became a frame.", "Look at SYN-501."),
    CodeMeaning(
        "no_reference",
        "refused",
        "Too few voxels lie under the track to learn what driven ground looks like.",
        "Drive farther; look at SYN-501 and CAL-433.",
    ),
    CodeMeaning(
        "off_lattice",
        "refused",
        "Positions are farther from the origin than a map reaches.",
        "Check the source of poses.",
    ),
    CodeMeaning(
        "poses_tilted",
        "refused",
        "By its poses the robot drives above or below where it faces, over ground that the sweeps show level.",
        "Enter the rotation of the INS that the message names; without an INS, correct the source of the poses.",
    ),
    CodeMeaning(
        "reader_crashed",
        "refused",
        "The process that read the file crashed or exceeded its limits.",
        "Check the file; report it if the file is sound.",
    ),
    CodeMeaning(
        "reader_interrupted", "refused", "The process that read the file was stopped by the machine.", "Process again."
    ),
    CodeMeaning(
        "recording_changed", "refused", "The bytes are not those that were uploaded.", "Upload the recording again."
    ),
    CodeMeaning(
        "recording_changed_in_place",
        "refused",
        "A recording or dataset that is read where it lies was changed since it was registered.",
        "Put the file back, or remove the recording or import and name the file anew.",
    ),
    CodeMeaning(
        "recording_file_missing",
        "refused",
        "The worker does not find the uploaded file.",
        "Ask an administrator to check the store.",
    ),
    CodeMeaning(
        "recording_refused", "refused", "The recording was refused earlier.", "Look at its findings under Recordings."
    ),
    CodeMeaning(
        "recording_vanished",
        "refused",
        "A recording or dataset in place is not below its root, or may not be read.",
        "Put it back, or mount the root on every worker of ingest and labeler.",
    ),
    CodeMeaning(
        "restarted_too_often",
        "refused",
        "Workers of two releases keep restarting the run in turns.",
        "Ask an administrator to upgrade all workers.",
    ),
    CodeMeaning(
        "root_unavailable",
        "refused",
        "The folder of a root for files in place is not on the worker.",
        "Mount it; the job is tried again.",
    ),
    CodeMeaning(
        "work_gone", "refused", "What earlier stages left was removed a week after the run ended.", "Process again."
    ),
    CodeMeaning(
        "worker_lost",
        "refused",
        "The worker sent no heartbeat, and no attempt is left.",
        "Process again; an administrator checks memory and the worker's log.",
    ),
)
