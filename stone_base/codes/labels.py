"""Meanings of LAB, IMP and QLT codes: labels, imported labels, and the quality of data."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "LAB-601",
        "wrong",
        "The track covers so few voxels that the reference terrain model is unreliable.",
        "Drive farther, or process again with profile field.",
    ),
    CodeMeaning(
        "LAB-602",
        "less",
        "Some frames contain no driven voxel, so no T.",
        "Look at these frames: nothing where the ground under the robot is out of the LiDAR's sight; see also LAB-607.",
    ),
    CodeMeaning(
        "LAB-603",
        "wrong",
        "The track spans little elevation, so ground that lies higher or lower is labelled N whatever its shape.",
        "Process again with profile field, which does not use absolute elevation.",
    ),
    CodeMeaning(
        "LAB-604",
        "wrong",
        "The slope of the driven ground scatters more than drivable ground does.",
        "Check the LiDAR's height and the footprint in the calibration.",
    ),
    CodeMeaning(
        "LAB-605",
        "wrong",
        "Many driven voxels are unlike the rest.",
        "Check mount and footprint; the driven terrain may be of several kinds.",
    ),
    CodeMeaning(
        "LAB-606",
        "wrong",
        "Some driven voxels are far from the rest and widen the reference terrain model.",
        "Process again with profile field, which leaves such voxels out of the reference. Check mount and footprint.",
    ),
    CodeMeaning(
        "LAB-607",
        "wrong",
        "A part of the ground that was driven over contains no T.",
        "Look at SYN-515, CAL-433 and the surface in map.png.",
    ),
    CodeMeaning(
        "LAB-608",
        "none",
        "Points beyond the range of any LiDAR are left out and change no label.",
        "Configure the driver to write NaN where nothing came back; if all points are so far, they are in millimetres.",
    ),
    CodeMeaning(
        "LAB-609",
        "wrong",
        "The surface of some tiles did not converge; slopes and heights there are wrong.",
        "Look at map.png, and report it with report.json.",
    ),
    CodeMeaning("LAB-611", "none", "The poses were refined; the sentence says by how much.", "Nothing."),
    CodeMeaning(
        "LAB-612",
        "wrong",
        "Some poses were too far from where refinement would put them, and stayed as given.",
        "Check the source of poses.",
    ),
    CodeMeaning(
        "LAB-613",
        "wrong",
        "Labels made from one half of the track call more than 30 % of the ground driven over in the other half N.",
        "Process again with profile field. If it is field already, check poses and mount, and drive over each kind of "
        "terrain.",
    ),
    CodeMeaning(
        "LAB-614",
        "less",
        "Labels made from one half of the track call 14 to 30 % of the ground driven over in the other half N.",
        "Process again with profile field, or drive farther over each kind of terrain: elsewhere it is N too.",
    ),
    CodeMeaning(
        "LAB-615",
        "wrong",
        "Many driven voxels are steeper or rougher than the vehicle's limits allow.",
        "Check the LiDAR's mount and the poses, and the limits under vehicle in the calibration. Tall grass that was "
        "driven through causes it too.",
    ),
    CodeMeaning(
        "IMP-601",
        "less",
        "The dataset does not say which voxels a ray reached: a free voxel may be one that was never observed.",
        "Nothing; consider it when you compare scores.",
    ),
    CodeMeaning(
        "IMP-602",
        "less",
        "The dataset does not say which voxels a camera sees, so scores within the cameras' view count all voxels.",
        "Nothing; consider it when you compare scores.",
    ),
    CodeMeaning("QLT-601", "less", "Sensors fall silent.", "Check their power and network."),
    CodeMeaning("QLT-602", "none", "A camera is much less sharp than the others.", "Clean and focus the lens."),
    CodeMeaning("QLT-603", "none", "Images are black or white in large parts.", "Set the exposure."),
    CodeMeaning("QLT-604", "wrong", "The LiDAR returns few points.", "Clean it, and check what covers it."),
    CodeMeaning("QLT-605", "none", "A radar detected nothing in many scans.", "Check its mount and driver."),
)
