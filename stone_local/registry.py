"""The platform's commands, as the `stone` command finds them (`stone_client/platform_part.py`)."""

from stone_client.lazy_commands import places

PACKAGE = "stone_local.commands"
COMMANDS = (
    *places(
        "On this machine",
        PACKAGE,
        "simulate",
        "inspect",
        "recover",
        "label",
        "export",
        "score",
        "ceiling",
        "check",
    ),
    *places("On this machine", PACKAGE, "demo"),
    *places("With a server", PACKAGE, "serve"),
    *places("Models", PACKAGE, "models.train", "models.predict", "models.onnx"),
)
GROUPS = places("On this machine", PACKAGE, "calibration", "label_sets")
