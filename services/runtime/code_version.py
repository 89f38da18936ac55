"""Code versions: which code computed a result, as 12 hex digits of a sha256.

**Conventions.** The version of a kind of result covers the digest of the code that computes it
(`services/runtime/source_digests.py`) and the versions of the libraries that calculate or decode for it. It does not
cover the release. A wheel contains both, fixed at its build, so all images of a build agree. In a checkout both are
those of this process: its sources when this module was imported, and its installed libraries. Digests of a checkout are
cached beside the compiled modules until a source file changes.
"""

import json
import re
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from services.runtime.source_digests import (
    ENTRIES,
    Digests,
    ResultKind,
    SourceDigest,
    installed_places,
    record_of,
    source_digests,
    sources_sha256,
)
from stone.errors import Refused
from stone_files.atomic import atomic_file

RELEASE = version("stone-platform")
FIXED = Path(__file__).with_name("source_digests.json")
KEPT = Path(__file__).with_name("__pycache__") / FIXED.name
SHOWN_DIGITS = 12
SHA256 = re.compile(r"[0-9a-f]{64}")
ABSENT = "absent"


def code_version(kind: ResultKind) -> str:
    """Return the version of the code that makes results of this kind in this process."""
    return version_of(_DIGESTS[kind])


def version_of(digest: SourceDigest) -> str:
    """Return the version of code with this digest; libraries without a fixed version count as installed."""
    libraries = [(name, known or installed_version(name)) for name, known in sorted(digest.libraries.items())]
    spelled = json.dumps([digest.sha256, libraries])
    return sha256(spelled.encode()).hexdigest()[:SHOWN_DIGITS]


def digests_in_force(fixed: Path, kept: Path) -> Digests:
    """Return the digests in the file `fixed` if it exists, else those of the sources, which `kept` may cache.

    Raises `broken_digests`, `sources_missing`, `unresolved_name`.
    """
    try:
        text = fixed.read_text("utf-8")
    except FileNotFoundError:
        return _digests_of_checkout(kept)
    try:
        return digests_from(json.loads(text))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise Refused(
            "broken_digests",
            f"{fixed} lacks a sha256 and library versions for each of {', '.join(ENTRIES)}; build and install the "
            "wheel again",
        ) from error


def digests_from(record: Mapping[str, Mapping[str, object]]) -> Digests:
    """Return the digests in a record of `record_of`.

    Raises ValueError, KeyError, TypeError or AttributeError for any other record.
    """
    digests = dict[ResultKind, SourceDigest]()
    for kind in ENTRIES:
        digest, libraries = record[kind]["sha256"], record[kind]["libraries"]
        if not isinstance(digest, str) or not SHA256.fullmatch(digest) or not isinstance(libraries, dict):
            raise ValueError(kind)
        digests[kind] = SourceDigest(digest, {str(name): str(number) for name, number in libraries.items()})
    return digests


def _digests_of_checkout(kept: Path) -> Digests:
    """Return the digests of the sources; parse the sources only if they changed."""
    places = installed_places()
    sources = sources_sha256(places)
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
        record = json.loads(kept.read_text("utf-8"))
        if record["sources"] == sources:
            return digests_from(record["digests"])
    digests = source_digests(places)
    with suppress(OSError):  # a read-only checkout
        kept.parent.mkdir(exist_ok=True)
        with atomic_file(kept) as staging:
            staging.write_text(json.dumps({"sources": sources, "digests": record_of(digests)}) + "\n", "utf-8")
    return digests


@cache
def installed_version(distribution: str) -> str:
    """Return the version of an installed distribution, or "absent"."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ABSENT


_DIGESTS = digests_in_force(FIXED, KEPT)
