"""Meanings of TIM and GNS codes: stamps, clocks and GNSS positions."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "TIM-201",
        "none",
        "The computer stamps the messages, not the sensor. For a GNSS receiver, GPS time is used instead.",
        "No action is needed for a receiver. For other sensors, configure the driver to use the sensor's own "
        "stamps if it can.",
    ),
    CodeMeaning(
        "TIM-202",
        "wrong",
        "A clock differs from the others by seconds.",
        "Repair the driver (18 s is GPS - UTC, 37 s is TAI - UTC), or copy the option or entry from the message.",
    ),
    CodeMeaning(
        "TIM-203",
        "less",
        "Stamps go backwards. Messages are sorted by stamp, and frames without a pose are left out.",
        "Check the recorder's disk and network.",
    ),
    CodeMeaning(
        "TIM-204",
        "less",
        "Messages are missing for longer than the usual interval.",
        "Check the recorder's disk and network.",
    ),
    CodeMeaning(
        "TIM-205",
        "wrong",
        "A camera fires when the LiDAR scans another direction, or the LiDAR's stamps are late.",
        "Set the trigger angle, and check the mount.",
    ),
    CodeMeaning(
        "TIM-206", "none", "Several messages have the same stamp; only the first is used.", "No action is needed."
    ),
    CodeMeaning("TIM-207", "wrong", "A clock drifts relative to the others.", "Synchronise the sensor with PTP."),
    CodeMeaning("TIM-208", "less", "Some triggers produced no image.", "Check the camera's bandwidth."),
    CodeMeaning(
        "TIM-209",
        "none",
        "The gyro shows turns earlier or later than the poses.",
        "Set the IMU's time_offset_ns to the value in the message.",
    ),
    CodeMeaning(
        "TIM-210",
        "wrong",
        "Some messages have no valid sensor time, because the sensor was not synchronised yet.",
        "Let the sensor synchronise before you record.",
    ),
    CodeMeaning(
        "TIM-211",
        "wrong",
        "Stamps are near 1970 because the clock was never set.",
        "Make the driver wait until the clock is set. Ignore this for a simulated run.",
    ),
    CodeMeaning(
        "TIM-212",
        "none",
        "The recorder's clock jumped; clocks are compared after the jump is removed.",
        "If sensors stamp their messages, no action is needed; otherwise set the computer's clock before you record.",
    ),
    CodeMeaning(
        "TIM-213",
        "wrong",
        "Poses and sweeps have a time offset, so moving smears the labels.",
        "Enter the value from the message as time_offset_ns or try it with --time-offset, and check again.",
    ),
    CodeMeaning(
        "TIM-214", "none", "A clock was shifted by the value in the calibration or the command.", "No action is needed."
    ),
    CodeMeaning(
        "TIM-220",
        "none",
        "Point times and header stamps use different clocks with a constant offset. The first or last point "
        "of a sweep is placed at the header stamp.",
        "Make the driver stamp headers and points with the same clock.",
    ),
    CodeMeaning(
        "GNS-301",
        "wrong",
        "RTK was not fixed throughout, or its status is unknown.",
        "Check the track; record BESTPOS in addition to INSPVAX.",
    ),
    CodeMeaning(
        "GNS-302",
        "wrong",
        "The poses jump, so the track is split at the jump.",
        "Check the receiver's view of the sky and its corrections.",
    ),
    CodeMeaning(
        "GNS-303",
        "less",
        "Samples without a solution or without an attitude are left out.",
        "Ignore a few samples; next time, wait for the solution before you drive.",
    ),
    CodeMeaning(
        "GNS-304",
        "wrong",
        "The receiver reports a large position uncertainty.",
        "Check the receiver's view of the sky and its corrections.",
    ),
    CodeMeaning(
        "GNS-305",
        "less",
        "Single poses far from the track are left out.",
        "Ignore a few poses; if there are many, check the pose source.",
    ),
    CodeMeaning(
        "GNS-306",
        "refused",
        "The recording contains positions but no attitude.",
        "Record an IMU that provides orientation, or use --odometry kiss-icp.",
    ),
    CodeMeaning(
        "GNS-310",
        "less",
        "Positions far from all others, such as zeros before a fix, are left out.",
        "Ignore a few positions; if there are many, check the receiver.",
    ),
)
