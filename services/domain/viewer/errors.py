"""Errors of the viewer: labels without a scene or without a playback."""

from stone.errors import StoneError


class NoSceneError(StoneError):
    """The labels were made by a release without a viewer."""

    code = "no_scene"

    def __init__(self, label_set_id: str) -> None:
        super().__init__(
            f"labels {label_set_id} were made by a version that kept nothing for the viewer; process the sequence again"
        )


class NoPlaybackError(StoneError):
    """The labels have no playback yet: none was asked for, its job is still at it, or failed."""

    code = "no_playback"

    def __init__(self, label_set_id: str) -> None:
        super().__init__(
            f"labels {label_set_id} have no playback yet: its job makes it after the labels; was it switched off, or "
            "deleted? Start an export of format playback"
        )
