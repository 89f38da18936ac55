"""Why a picture, a packet or a definition is refused: one leaf per reason, one sentence each."""

from stone_recordings.bags.errors import IngestError

SHOWN_CHARACTERS = 80


class PictureError(IngestError):
    """An image that is damaged, of an encoding that is not read, or larger than any camera's."""

    code = "MSG-306"

    def __init__(self, type_name: str, problem: str) -> None:
        super().__init__(f"{type_name}: {problem}; record Image (mono, rgb, bgr, bayer) or JPEG or PNG from the driver")


class DefinitionRefusedError(IngestError):
    """A message definition that cannot be one: bad syntax, a cycle, or more than any real definition holds."""

    code = "MSG-307"

    def __init__(self, where: str, problem: str) -> None:
        super().__init__(f"definition of {where[:SHOWN_CHARACTERS]!r}: {problem}; upload the package's own .msg files")


class PacketError(IngestError):
    """A radar packet whose lengths or counts contradict the ARS 548 interface."""

    code = "MSG-308"

    def __init__(self, problem: str) -> None:
        super().__init__(f"nebula_msgs/msg/NebulaPackets: {problem}; the packet is damaged or of another sensor")
