"""Meanings of TIM and GNS codes: stamps, clocks and positions of a receiver."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "TIM-201",
        "none",
        "Messages are stamped by the computer, not by the sensor; for a receiver, GPS time is used instead.",
        "Nothing for a receiver. For other sensors, let the driver use the sensor's own stamps where it can.",
    ),
    CodeMeaning(
        "TIM-202",
        "wrong",
        "A clock is seconds away from the others.",
        "Repair the driver (18 s is GPS - UTC, 37 s is TAI - UTC), or copy the option or the entry of the sentence.",
    ),
    CodeMeaning(
        "TIM-203",
        "less",
        "Stamps go backwards; they are sorted, and frames without a pose are left out.",
        "Check the recorder's disk and network.",
    ),
    CodeMeaning(
        "TIM-204", "less", "Messages are missing for longer than usual.", "Check the recorder's disk and network."
    ),
    CodeMeaning(
        "TIM-205",
        "wrong",
        "A camera fires when the LiDAR scans another direction, or the LiDAR's stamp is late.",
        "Set the trigger's angle, and check the mount.",
    ),
    CodeMeaning("TIM-206", "none", "Messages repeat a stamp; the first of each stamp is used.", "Nothing."),
    CodeMeaning("TIM-207", "wrong", "A clock drifts against the others.", "Synchronise the sensor by PTP."),
    CodeMeaning("TIM-208", "less", "Triggers gave no image.", "Check the camera's bandwidth."),
    CodeMeaning(
        "TIM-209",
        "none",
        "The gyro shows turns earlier or later than the poses do.",
        "Set the IMU's time_offset_ns to the value in the sentence.",
    ),
    CodeMeaning(
        "TIM-210",
        "wrong",
        "In some messages the sensor had no time, because it was not synchronised yet.",
        "Let it synchronise before recording.",
    ),
    CodeMeaning(
        "TIM-211",
        "wrong",
        "Stamps are near 1970: the clock was never set.",
        "Let the driver wait for its clock; nothing for a simulated run.",
    ),
    CodeMeaning(
        "TIM-212",
        "none",
        "The recorder's clock jumped; clocks are compared without the jump.",
        "Nothing where sensors stamp; otherwise set the computer's clock before recording.",
    ),
    CodeMeaning(
        "TIM-213",
        "wrong",
        "Poses and sweeps differ in time; labels are smeared by what the robot moves in that time.",
        "Enter the named value as time_offset_ns, or try it with --time-offset, and look again.",
    ),
    CodeMeaning("TIM-214", "none", "A clock was shifted, as the calibration or the command says.", "Nothing."),
    CodeMeaning(
        "TIM-220",
        "none",
        "Point times are on another clock than the header stamps, by a constant; the first or the last point of a sweep"
        " is taken to be at its stamp.",
        "Let the driver stamp headers and points by one clock.",
    ),
    CodeMeaning(
        "GNS-301",
        "wrong",
        "RTK was not fixed all the time, or its status is unknown.",
        "Look at the track; record BESTPOS beside INSPVAX.",
    ),
    CodeMeaning(
        "GNS-302",
        "wrong",
        "The poses jump; the track is split there.",
        "Check the receiver's view of the sky and its corrections.",
    ),
    CodeMeaning(
        "GNS-303",
        "less",
        "Samples without a solution, or without an attitude, are left out.",
        "Nothing for a few; wait for the solution before driving.",
    ),
    CodeMeaning(
        "GNS-304",
        "wrong",
        "The receiver reports a large uncertainty of its positions.",
        "Check its view of the sky and its corrections.",
    ),
    CodeMeaning(
        "GNS-305",
        "less",
        "Single poses far off the track are left out.",
        "Nothing for a few; check the source where there are many.",
    ),
    CodeMeaning(
        "GNS-306",
        "refused",
        "There are positions, but nothing gives the attitude.",
        "Record an IMU that gives an orientation, or use --odometry kiss-icp.",
    ),
    CodeMeaning(
        "GNS-310",
        "less",
        "Positions far from all others, such as zeros before a fix, are left out.",
        "Nothing for a few; check the receiver if there are many.",
    ),
)
