"""Meanings of LAB, IMP and QLT codes: labels, imported labels, and the quality of data."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "LAB-601",
        "wrong",
        "The track covers too few voxels for a reliable reference terrain model.",
        "Drive farther, or process again with profile field.",
    ),
    CodeMeaning(
        "LAB-602",
        "less",
        "Some frames contain no driven voxel, so they have no T.",
        "Check these frames. No action is needed if the LiDAR cannot see the ground under the robot; see also LAB-607.",
    ),
    CodeMeaning(
        "LAB-603",
        "wrong",
        "The track spans little elevation, so higher or lower ground is labelled N regardless of its shape.",
        "Process again with profile field, which does not use absolute elevation.",
    ),
    CodeMeaning(
        "LAB-604",
        "wrong",
        "The slope of the driven ground varies more than on drivable ground.",
        "Check the LiDAR's height and the footprint in the calibration.",
    ),
    CodeMeaning(
        "LAB-605",
        "wrong",
        "Many driven voxels differ from the rest.",
        "Check mount and footprint; the driven terrain may be of several kinds.",
    ),
    CodeMeaning(
        "LAB-606",
        "wrong",
        "Some driven voxels differ strongly from the rest and widen the reference terrain model.",
        "Process again with profile field, which excludes such voxels from the reference. Check mount and footprint.",
    ),
    CodeMeaning(
        "LAB-607",
        "wrong",
        "Part of the driven ground contains no T.",
        "Check SYN-515, CAL-433 and the surface in map.png.",
    ),
    CodeMeaning(
        "LAB-608",
        "none",
        "Points beyond the range of any LiDAR are left out; labels are unaffected.",
        "Configure the driver to write NaN if no echo returns. If all points are this far away, their unit is "
        "probably millimetres.",
    ),
    CodeMeaning(
        "LAB-609",
        "wrong",
        "The surface of some tiles did not converge, so their slopes and heights are wrong.",
        "Check map.png, and report the problem with report.json.",
    ),
    CodeMeaning(
        "LAB-611", "none", "The poses were refined; the message contains the correction.", "No action is needed."
    ),
    CodeMeaning(
        "LAB-612",
        "wrong",
        "Some poses were too far from their refined position and stayed unchanged.",
        "Check the pose source.",
    ),
    CodeMeaning(
        "LAB-613",
        "wrong",
        "Labels made from one half of the track classify more than 30 % of the driven ground in the other half as N.",
        "Process again with profile field. If the profile is already field, check poses and mount, and drive "
        "over each kind of terrain.",
    ),
    CodeMeaning(
        "LAB-614",
        "less",
        "Labels made from one half of the track classify 14 to 30 % of the driven ground in the other half as N.",
        "Process again with profile field, or drive farther over each kind of terrain. Terrain that you do "
        "not drive over may also be labelled N.",
    ),
    CodeMeaning(
        "LAB-615",
        "wrong",
        "Many driven voxels exceed the vehicle's limits for slope or roughness.",
        "Check the LiDAR's mount, the poses, and the limits under vehicle in the calibration. Driving through "
        "tall grass also has this effect.",
    ),
    CodeMeaning(
        "IMP-601",
        "less",
        "The dataset does not record which voxels a ray reached, so a free voxel may never have been observed.",
        "No action is needed; consider this when you compare scores.",
    ),
    CodeMeaning(
        "IMP-602",
        "less",
        "The dataset does not record which voxels a camera sees, so scores within the cameras' view count all voxels.",
        "No action is needed; consider this when you compare scores.",
    ),
    CodeMeaning("QLT-601", "less", "Sensors stop sending messages.", "Check the sensors' power and network."),
    CodeMeaning("QLT-602", "none", "A camera is much less sharp than the others.", "Clean and focus the lens."),
    CodeMeaning("QLT-603", "none", "Large parts of images are black or white.", "Adjust the exposure."),
    CodeMeaning(
        "QLT-604", "wrong", "The LiDAR returns few points.", "Clean the LiDAR, and check whether anything covers it."
    ),
    CodeMeaning("QLT-605", "none", "A radar detected nothing in many scans.", "Check the radar's mount and driver."),
)
