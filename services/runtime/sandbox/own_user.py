"""A user of its own for the sandboxed child of a root process.

**Conventions.** Root may become anybody: such a child takes a user and group that nobody else has, so that it signals,
traces, slows down and changes nothing of the service, even where every other fence is missing. Of root's capabilities
it keeps the one to open files whatever their modes, as before: what it may open says Landlock. What it leaves is given
back to the service's user (`folder_bounds.py`). A service of another user has no such means: a user namespace holds
its own user alone, and further users (subuid(5)) only a setuid program may map, which containers do not have.
"""

import ctypes
import os
import struct

NOBODY_ELSE = 0x7000_0000  # and the process's number: beyond what distributions and user databases give out
PR_SET_KEEPCAPS = 8
CAP_DAC_OVERRIDE = 1 << 1
CAPABILITIES_3 = 0x2008_0522
CAPSET = {"x86_64": 126, "aarch64": 91}
_LIBC = ctypes.CDLL(None, use_errno=True)


def leave_the_user() -> bool:
    """Become a user that nobody else is; whether this process was root and could.

    The process has one thread. Its files under `/proc` are root's from then on.
    """
    machine = os.uname().machine
    if os.geteuid() != 0 or machine not in CAPSET or _LIBC.prctl(PR_SET_KEEPCAPS, 1, 0, 0, 0) != 0:
        return False
    own = NOBODY_ELSE + os.getpid()
    try:
        os.setgroups([])
        os.setresgid(own, own, own)
        os.setresuid(own, own, own)
    except OSError:  # a container without the capability, or whose users end before
        return False
    head = struct.pack("<Ii", CAPABILITIES_3, 0)
    kept = struct.pack("<6I", CAP_DAC_OVERRIDE, CAP_DAC_OVERRIDE, 0, 0, 0, 0)
    if _LIBC.syscall(CAPSET[machine], head, kept) != 0:
        raise OSError(ctypes.get_errno(), "capabilities cannot be given up")
    return True
