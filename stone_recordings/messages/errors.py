"""Refusals of pictures, packets and definitions: one sentence each."""

from stone_recordings.bags.errors import IngestError

SHOWN_CHARACTERS = 80


class PictureError(IngestError):
    """An image is damaged, in an unsupported encoding, or larger than any camera's."""

    def __init__(self, type_name: str, problem: str) -> None:
        super().__init__(
            "MSG-306",
            f"{type_name}: {problem}; record Image (mono, rgb, bgr, bayer, yuv), JPEG or PNG from the driver",
        )


class DefinitionRefusedError(IngestError):
    """An invalid message definition: bad syntax, a cycle, or larger than any real one."""

    def __init__(self, where: str, problem: str) -> None:
        super().__init__(
            "MSG-307", f"definition of {where[:SHOWN_CHARACTERS]!r}: {problem}; upload the package's own .msg files"
        )


class LidarPacketError(IngestError):
    """LiDAR packets are of an unsupported model, or damaged."""

    def __init__(self, type_name: str, model: str, instead: str) -> None:
        super().__init__(
            "MSG-313",
            f"{type_name}: its packets are of {model}; decoded are VLP-16, VLP-32C, VLS-128, Pandar40P and OT128: "
            f"{instead}",
        )
