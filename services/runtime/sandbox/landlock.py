"""Landlock rules: a sandboxed child writes below one folder only, connects nowhere, signals nobody outside.

**Conventions.** Linux 5.13 and later (landlock(7)); what a kernel does not know of the list below is left out. It holds
for root too, cannot be taken off, and is asked for without any privilege. Reading stays as the file's mode says.
"""

import ctypes
import os
import struct
from pathlib import Path

CREATE, ADD, RESTRICT = 444, 445, 446  # the same on every machine
VERSION_ASKED, BENEATH = 1, 1
PR_SET_NO_NEW_PRIVS = 38
EXECUTE, WRITE_FILE, REFER, TRUNCATE, IOCTL_DEV = 1 << 0, 1 << 1, 1 << 13, 1 << 14, 1 << 15
MAKING = sum(1 << bit for bit in range(4, 13))  # remove_dir, remove_file, make_char to make_sym
REGULAR = sum(1 << bit for bit in (4, 5, 7, 8, 12))  # of those: folders, files and links
SINCE = {1: EXECUTE | WRITE_FILE | MAKING, 2: REFER, 3: TRUNCATE, 5: IOCTL_DEV}
TCP = 0b11  # bind and connect, since version 4
SCOPES = 0b11  # abstract sockets and signals, since version 6

_LIBC = ctypes.CDLL(None, use_errno=True)


def version() -> int:
    """The Landlock version of this kernel; 0 where it has none, or was started without."""
    return max(0, int(_LIBC.syscall(CREATE, None, ctypes.c_size_t(0), VERSION_ASKED)))


def write_below(folder: Path | None) -> bool:
    """Restrict this process to change files below `folder` only, or none; returns whether the kernel took it."""
    spoken = version()
    if spoken == 0 or _LIBC.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        return False
    held = sum(rights for since, rights in SINCE.items() if since <= spoken)
    rules = struct.pack("<QQQ", held, TCP, SCOPES)[: 8 if spoken < 4 else 16 if spoken < 6 else 24]
    ruleset = _LIBC.syscall(CREATE, rules, ctypes.c_size_t(len(rules)), 0)
    if ruleset < 0:
        return False
    try:
        is_allowed = folder is None or _allow(ruleset, folder, held & (WRITE_FILE | REGULAR | REFER | TRUNCATE))
        return is_allowed and bool(_LIBC.syscall(RESTRICT, ruleset, 0) == 0)
    finally:
        os.close(ruleset)


def _allow(ruleset: int, folder: Path, rights: int) -> bool:
    below = os.open(folder, os.O_PATH | os.O_DIRECTORY)
    try:
        rule = struct.pack("<Qi", rights, below)
        return bool(_LIBC.syscall(ADD, ruleset, BENEATH, rule, 0) == 0)
    finally:
        os.close(below)
