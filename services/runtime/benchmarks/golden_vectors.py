"""The golden vectors as one file: grids, and what the metric says of them, so that anybody can check another program.

**Conventions.** The zip is made of the files beside this module, in the order of their names and with one date, so it
is the same bytes everywhere; it is held by a process once it was asked for.
"""

import io
import zipfile
from functools import cache
from hashlib import sha256
from pathlib import Path

FOLDER = Path(__file__).resolve().parent / "golden"
DATED = (1980, 1, 1, 0, 0, 0)


@cache
def golden_zip() -> tuple[bytes, str]:
    """The zip and its sha256."""
    written = io.BytesIO()
    with zipfile.ZipFile(written, "w") as archive:
        for path in sorted(path for path in FOLDER.rglob("*") if path.is_file()):
            named = zipfile.ZipInfo(path.relative_to(FOLDER).as_posix(), DATED)
            named.compress_type, named.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(named, path.read_bytes())
    content = written.getvalue()
    return content, sha256(content).hexdigest()
