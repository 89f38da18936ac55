"""A fast check for the common npz file: a zip of one array with no unusual features.

**Conventions.** What is recognised here is read just so by `stone_submissions/zip_directory.py` too; whatever is in any
way else is left to that, which also says what is wrong. One frame takes a third of a millisecond, of which reading its
headers in full would be a tenth.

Source: as in `zip_directory`; numpy writes wide sizes into the local header and narrow ones into the directory.
"""

import stat
import struct

from stone_submissions.zip_directory import DEFLATED, LOCAL, RECORD, STORED, ZipMember
from stone_submissions.zip_end import END, IN_EXTRA_32

WIDE = struct.Struct("<2H2Q")
WIDE_SIZES = 1, 16
LEAST_BYTES = LOCAL.size + RECORD.size + END.size

Buffer = bytes | bytearray | memoryview


def plain_member(npz: Buffer, names: tuple[bytes, ...]) -> tuple[ZipMember, int] | None:
    """The one file of this zip, of one of these names, and where its bytes start; None if anything is unusual."""
    end_at = len(npz) - END.size
    if len(npz) < LEAST_BYTES:
        return None
    mark, disk, start_disk, here, entries, directory_bytes, directory_at, comment = END.unpack_from(npz, end_at)
    if mark != b"PK\5\6" or (disk, start_disk, here, entries, comment) != (0, 0, 1, 1, 0):
        return None
    if directory_at + directory_bytes != end_at or directory_bytes < RECORD.size or directory_at < LOCAL.size:
        return None
    mark, made_by, _, flags, method, _, _, crc32, packed, unpacked, *rest = RECORD.unpack_from(npz, directory_at)
    name_bytes, extra, comment, disk, _, attributes, at = rest
    name = bytes(npz[directory_at + RECORD.size : end_at])
    if mark != b"PK\1\2" or name not in names or name_bytes != len(name) or flags or made_by >> 8 > 3:
        return None
    if (extra, comment, disk, at) != (0, 0, 0, 0) or stat.S_ISLNK(attributes >> 16):
        return None
    if unpacked == IN_EXTRA_32 or (method != DEFLATED and (method != STORED or packed != unpacked)):
        return None
    start = _data_start(npz, (method, packed, unpacked, name))
    if start is None or start + packed != directory_at:
        return None
    return ZipMember(name.decode("ascii"), method, crc32, packed, unpacked, 0, directory_at), start


def _data_start(npz: Buffer, known: tuple[int, int, int, bytes]) -> int | None:
    """Behind the local header, where that says what is known."""
    method, packed, unpacked, name = known
    mark, _, flags, own_method, _, _, _, *sizes, name_bytes, extra_bytes = LOCAL.unpack_from(npz)
    start = LOCAL.size + len(name)
    if mark != b"PK\3\4" or flags or own_method != method or name_bytes != len(name) or npz[LOCAL.size : start] != name:
        return None
    if sizes == [packed, unpacked] and not extra_bytes and IN_EXTRA_32 not in sizes:
        return start
    is_wide = sizes == [IN_EXTRA_32, IN_EXTRA_32] and extra_bytes == WIDE.size
    is_same = is_wide and npz[start : start + WIDE.size] == WIDE.pack(*WIDE_SIZES, unpacked, packed)
    return start + WIDE.size if is_same else None
