"""The reader's class colours, from the switch in the footer of every page.

**Conventions.** The cookie holds a palette's name of `stone/labels/class_colours.py`; anything else counts as the
default. A cookie, so that the server draws the first picture right; none of an account, since visitors have none.
"""

from fastapi import Request

from stone.labels.class_colours import PALETTES, ColourName

COOKIE = "stone_colours"


def colours_of(request: Request) -> ColourName:
    """The palette that class colours are shown in."""
    asked = request.cookies.get(COOKIE, "")
    return next((name for name in PALETTES if name == asked), "default")


def coloured(url: str, colours: ColourName) -> str:
    """The address of a picture of labels in this palette."""
    if colours == "default":
        return url
    return f"{url}{'&' if '?' in url else '?'}colours={colours}"
