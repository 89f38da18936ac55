"""The platform's commands, as `stone_client/platform_part.py` loads them."""

from stone_client.lazy_commands import CommandPlace, GroupPlace, Place, places

PACKAGE = "stone_local.commands"
HERE = "On this machine"
CALIBRATION = GroupPlace(
    "calibration",
    HERE,
    "Check a calibration before labelling, and draw the rig.",
    (
        CommandPlace("check", "", f"{PACKAGE}.calibration", "check"),
        CommandPlace("init", "", f"{PACKAGE}.calibration", "init"),
        CommandPlace("show", "", f"{PACKAGE}.calibration", "show_rig"),
    ),
)
MODEL = GroupPlace(
    "model",
    HERE,
    "Train a row of the benchmark, predict with it, and export its network.",
    places("", PACKAGE, "models.train", "models.predict", "models.onnx"),
)
COMMANDS: tuple[Place, ...] = (
    *places(HERE, PACKAGE, "simulate", "inspect"),
    CALIBRATION,
    *places(HERE, PACKAGE, "recover", "label", "export", "check", "ceiling"),
    MODEL,
    *places(HERE, PACKAGE, "demo", "serve"),
)
