"""A user of its own for the sandboxed child of a root process.

**Conventions.** Root can take any user: its child takes a user and group that no other process has. The child can
therefore not signal, trace, slow down or change the service, even if every other fence is missing. It keeps only root's
capability to open files regardless of their modes, and Landlock limits the files. The service's user becomes the owner
of its remaining files (`folder_bounds.py`). A service of another user has no such means. A user namespace contains its
own user only, and mapping further users (subuid(5)) requires a setuid program, which containers do not have.
"""

import ctypes
import os
import struct

NOBODY_ELSE = 0x7000_0000  # plus the process ID: above the IDs that distributions and user databases assign
PR_SET_KEEPCAPS = 8
CAP_DAC_OVERRIDE = 1 << 1
CAPABILITIES_3 = 0x2008_0522
CAPSET = {"x86_64": 126, "aarch64": 91}
_LIBC = ctypes.CDLL(None, use_errno=True)


def leave_the_user() -> bool:
    """Switch to a user of its own; return whether this process was root and could.

    The process has one thread. Root owns its files under `/proc` afterwards.
    """
    machine = os.uname().machine
    if os.geteuid() != 0 or machine not in CAPSET or _LIBC.prctl(PR_SET_KEEPCAPS, 1, 0, 0, 0) != 0:
        return False
    own = NOBODY_ELSE + os.getpid()
    try:
        os.setgroups([])
        os.setresgid(own, own, own)
        os.setresuid(own, own, own)
    except OSError:  # the container lacks the capability or user IDs this high
        return False
    head = struct.pack("<Ii", CAPABILITIES_3, 0)
    kept = struct.pack("<6I", CAP_DAC_OVERRIDE, CAP_DAC_OVERRIDE, 0, 0, 0, 0)
    if _LIBC.syscall(CAPSET[machine], head, kept) != 0:
        raise OSError(ctypes.get_errno(), "capabilities cannot be dropped")
    return True
