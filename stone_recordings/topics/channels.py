"""Channels of cameras and radars: by the frame of their messages, else by the words of their names.

**Conventions.** Channels are nuScenes' (CAM_FRONT_LEFT, RADAR_RIGHT). A frame that a calibration knows decides; else
the words front, back (rear), left and right of the topic, and only where it has none those of the frame. Words that
contradict each other, or that are not there, name no channel.
"""

import re
from collections.abc import Mapping
from typing import Literal

ChannelKind = Literal["camera", "radar"]
PREFIX: Mapping[ChannelKind, str] = {"camera": "CAM", "radar": "RADAR"}
ENDS = {"front": "FRONT", "forward": "FRONT", "fwd": "FRONT", "back": "BACK", "rear": "BACK", "backward": "BACK"}
SIDES = {"left": "LEFT", "right": "RIGHT"}
SHORT = {"fl": ("front", "left"), "fr": ("front", "right")} | {
    short + side[0]: ("back", side) for short in "br" for side in SIDES
}
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def channel_of(kind: ChannelKind, topic: str, frame_id: str, channel_of_frame: Mapping[str, str]) -> str | None:
    """The channel, or None where neither frame nor names tell; `channel_of_frame` is the calibration's, by frame_id."""
    known = channel_of_frame.get(frame_id.strip("/"))
    if known is not None and known.startswith(PREFIX[kind]):
        return known
    return channel_of_words(kind, topic) or channel_of_words(kind, frame_id)


def channel_of_words(kind: ChannelKind, name: str) -> str | None:
    """CAM_FRONT_LEFT for "/camera/frontLeft/image", "cam_fl" or "/left/front_camera"; None without such words."""
    words = [word for found in WORD.findall(name) for word in _spelt(found.lower())]
    ends = {ENDS[word] for word in words if word in ENDS}
    sides = {SIDES[word] for word in words if word in SIDES}
    if len(ends) > 1 or len(sides) > 1 or not ends | sides:
        return None
    return "_".join([PREFIX[kind], *ends, *sides])


def _spelt(word: str) -> tuple[str, ...]:
    """ "frontleft" and "fl" as the two words they are."""
    if word in SHORT:
        return SHORT[word]
    for end in ENDS:
        if word.startswith(end) and word.removeprefix(end) in SIDES:
            return (end, word.removeprefix(end))
    return (word,)
