"""System calls by their number, as code outside Python makes them."""

import ctypes
import os

_LIBC = ctypes.CDLL(None, use_errno=True)
# By name: x86_64, aarch64, from the headers of the kernel.
NUMBERS = {
    "socket": (41, 198), "socketpair": (53, 199), "clone": (56, 220), "process_vm_readv": (310, 270),
    "ptrace": (101, 117), "prlimit64": (302, 261), "mount": (165, 40), "setuid": (105, 146), "unshare": (272, 97),
    "io_uring_setup": (425, 425), "setxattrat": (463, 463), "ioprio_set": (251, 30), "prctl": (157, 167),
    "unknown yet": (2000, 2000),
}  # fmt: skip


def system_call(name: str, *arguments: int | bytes) -> int:
    """Return the result of the call. Raises `OSError`."""
    number = NUMBERS[name][os.uname().machine == "aarch64"]
    given = (argument if isinstance(argument, bytes) else ctypes.c_long(argument) for argument in arguments)
    answer = _LIBC.syscall(number, *given)
    if answer == -1:
        raise OSError(ctypes.get_errno(), name)
    return int(answer)
