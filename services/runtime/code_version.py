"""Code versions: by what code a result was made, as `<release>+<12 hex digits of the digest of its sources>`.

**Conventions.** The digests are those of a file beside this module where the build of a wheel wrote one (images have
it), else those of the sources as they were when this module was loaded: what is changed later is not what runs. The
release stands for the libraries that it locks.
"""

import json
import re
from importlib.metadata import version
from pathlib import Path

from services.runtime.source_digests import SOURCES, ResultKind, source_digests
from stone.errors import StoneError

RELEASE = version("stone-platform")
FIXED = Path(__file__).with_name("source_digests.json")
SHOWN_DIGITS = 12
SHA256 = re.compile(r"[0-9a-f]{64}")


class BrokenDigestsError(StoneError):
    """The digests that a build wrote cannot be read."""

    code = "broken_digests"

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} holds no sha256 for each of {', '.join(SOURCES)}; build and install the wheel again")


def code_version(kind: ResultKind) -> str:
    """The version of the code that makes results of this kind in this process."""
    return f"{RELEASE}+{_DIGESTS[kind][:SHOWN_DIGITS]}"


def digests_in_force(fixed: Path) -> dict[ResultKind, str]:
    """The digests in the file if it is there, else those of the sources.

    Raises `BrokenDigestsError`, `SourcesMissingError`.
    """
    try:
        text = fixed.read_text("utf-8")
    except FileNotFoundError:
        return source_digests()
    try:
        digests: dict[ResultKind, str] = {kind: json.loads(text)[kind] for kind in SOURCES}
        if all(SHA256.fullmatch(digest) for digest in digests.values()):
            return digests
    except (ValueError, KeyError, TypeError) as error:
        raise BrokenDigestsError(fixed) from error
    raise BrokenDigestsError(fixed)


_DIGESTS = digests_in_force(FIXED)
