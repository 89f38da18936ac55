"""A seccomp filter that lets a sandboxed child make the system calls of its kind, and no others.

| kind   | child                              | besides memory, threads, time, reading and open descriptors       |
|--------|------------------------------------|-------------------------------------------------------------------|
| reads  | without a folder                   | nothing                                                           |
| writes | with a folder                      | opening for writing, creating, moving, removing (Landlock limits) |
| links  | with a folder that may hold links  | the same, and links                                               |

**Conventions.** Classic BPF over `struct seccomp_data` (seccomp(2)). A known call that is not listed
(`system_calls.py`) returns EPERM, an ordinary error to the child. A call that is newer than the list returns ENOSYS, as
on an older kernel. Calls by another machine's numbers kill the child. The filter cannot be removed and binds root too.
`clone3` keeps its flags in memory that no filter can read, so it returns ENOSYS and the C library uses `clone`, which
passes for threads and not for processes.

Arguments decide about calls that act on others by number, path or descriptor. The child can signal only itself. It can
read limits but not raise them. It can duplicate and lock a descriptor, but not choose a process that receives its
signals. It can truncate a file only if it may write the file. A pair of local sockets passes: a library's event loop
wakes itself with it, and it leads nowhere else.
"""

import ctypes
import errno
import fcntl
import os
import socket
import struct
import termios
from collections.abc import Mapping

from services.runtime.sandbox import system_calls
from services.runtime.sandbox.limits import SandboxLimits
from services.runtime.sandbox.system_calls import MACHINES, NEWEST

AUDIT_ARCH = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
CALL = {"x86_64": 317, "aarch64": 277}
SET_MODE_FILTER, SPEC_ALLOW = 1, 1 << 2  # without it, older kernels slow down the child's branches
ACTION_IS_KNOWN = 2
PR_SET_NO_NEW_PRIVS = 38
X32_BIT = 0x4000_0000
ALLOW, KILL, REFUSE = 0x7FFF0000, 0x80000000, 0x00050000
LOAD, EQUAL, SET, AT_LEAST, RETURN = 0x20, 0x15, 0x45, 0x35, 0x06
NUMBER_AT, ARCH_AT, ARGUMENTS_AT = 0, 4, 16
CLONE_THREAD = 0x10000
WRITING = os.O_WRONLY | os.O_RDWR
CHANGING = WRITING | os.O_CREAT | os.O_TRUNC
KINDS = ("reads", "writes", "links")

# For fcntl(2): duplicates, flags, locks and the fill of a pipe; no owners, signals, leases, seals or notices.
OF_DESCRIPTORS = (
    *(fcntl.F_DUPFD, fcntl.F_DUPFD_CLOEXEC, fcntl.F_GETFD, fcntl.F_SETFD, fcntl.F_GETFL, fcntl.F_SETFL),
    *(fcntl.F_GETLK, fcntl.F_SETLK, fcntl.F_SETLKW, fcntl.F_OFD_GETLK, fcntl.F_OFD_SETLK, fcntl.F_OFD_SETLKW),
    1032,  # F_GETPIPE_SZ
)
TCGETS2 = 0x802C542A  # newer C libraries detect a terminal with it
OF_DEVICES = (
    *(termios.TCGETS, TCGETS2, termios.TIOCGWINSZ),
    *(termios.FIONREAD, termios.FIONBIO, termios.FIOCLEX, termios.FIONCLEX),
)
# For prctl(2): the names of threads and of memory, huge pages, and reading the process's state.
OF_ITSELF = (
    *(15, 16, 0x53564D41),  # PR_SET_NAME, PR_GET_NAME, PR_SET_VMA
    *(2, 3, 21, 23, 39),  # PR_GET_PDEATHSIG, _DUMPABLE, _SECCOMP, PR_CAPBSET_READ, PR_GET_NO_NEW_PRIVS
    *(41, 42),  # PR_SET_THP_DISABLE, PR_GET_THP_DISABLE
)

Program = list[bytes]
_LIBC = ctypes.CDLL(None, use_errno=True)


class _Filter(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_char_p))


def kind_of(limits: SandboxLimits) -> str:
    """Return the child's kind, one of `KINDS`."""
    if limits.folder is None:
        return "reads"
    return "links" if limits.makes_links else "writes"


def is_known() -> bool:
    """Return whether this kernel, and the existing fences of this process, allow a filter."""
    machine = os.uname().machine
    answer = ctypes.c_uint32(REFUSE)
    return machine in MACHINES and bool(_LIBC.syscall(CALL[machine], ACTION_IS_KNOWN, 0, ctypes.byref(answer)) == 0)


def allow_calls(kind: str) -> bool:
    """Install the filter for this process and its later threads; return whether the kernel accepted it."""
    machine = os.uname().machine
    if machine not in MACHINES or _LIBC.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        return False
    program = program_of(machine, os.getpid(), kind)
    taken = _Filter(len(program), b"".join(program))
    return bool(_LIBC.syscall(CALL[machine], SET_MODE_FILTER, SPEC_ALLOW, ctypes.byref(taken)) == 0)


def program_of(machine: str, pid: int, kind: str) -> Program:
    """Return the filter for the process `pid`, one instruction per entry.

    Calls with checked arguments come first; the kernel caches the other calls that always pass.
    """
    program = [_op(LOAD, ARCH_AT), _op(EQUAL, AUDIT_ARCH[machine], 1, 0), _op(RETURN, KILL), _op(LOAD, NUMBER_AT)]
    if machine == "x86_64":
        program += [_op(AT_LEAST, X32_BIT, 0, 1), _op(RETURN, KILL)]
    blocks = _checked_calls(pid, may_write=kind != "reads")
    for name, number in system_calls.JUDGED[machine].items():
        program += [_op(EQUAL, number, 0, len(blocks[name])), *blocks[name]]
    for number in allowed(machine, kind).values():
        program += [_op(EQUAL, number, 0, 1), _op(RETURN, ALLOW)]  # a jump to a common end is too far
    for number in system_calls.ABSENT[machine].values():
        program += [_op(EQUAL, number, 0, 1), _op(RETURN, REFUSE | errno.ENOSYS)]
    return [
        *program,
        *(_op(AT_LEAST, NEWEST + 1, 0, 1), _op(RETURN, REFUSE | errno.ENOSYS)),
        _op(RETURN, REFUSE | errno.EPERM),
    ]


def allowed(machine: str, kind: str) -> Mapping[str, int]:
    """Return the calls that pass with any arguments."""
    calls = system_calls
    groups = [calls.DESCRIPTORS, calls.MEMORY, calls.THREADS, calls.ITSELF, calls.PATHS]
    groups += [calls.WRITING] * (kind != "reads") + [calls.LINKING] * (kind == "links")
    return {name: number for group in groups for name, number in group[machine].items()}


def _checked_calls(pid: int, *, may_write: bool) -> dict[str, Program]:
    """Return the instructions for calls that depend on their arguments."""
    to_itself = _allow_one_of(0, pid)
    opening = _refuse_truncation if may_write else _opens_to_read
    return {
        "openat": opening(2),
        "open": opening(1),
        "fcntl": [*_refuse_if(1, fcntl.F_SETFL, 2, os.O_ASYNC), *_allow_one_of(1, *OF_DESCRIPTORS)],
        "ioctl": _allow_one_of(1, *OF_DEVICES),
        "prctl": _allow_one_of(0, *OF_ITSELF),
        "prlimit64": _require_null(2),
        "clone": [_op(LOAD, _at(0)), _op(SET, CLONE_THREAD, 1, 0), *ENDS],
        "kill": to_itself,
        "tgkill": to_itself,
        "tkill": to_itself,
        "socketpair": _allow_one_of(0, socket.AF_UNIX),
    }


def _allow_one_of(argument: int, *values: int) -> Program:
    """Allow only these values of the argument's lower half, which is all that the kernel reads of 32-bit numbers."""
    last = len(values)
    return [
        _op(LOAD, _at(argument)),
        *(_op(EQUAL, value, last - index, 0) for index, value in enumerate(values)),
        *ENDS,
    ]


def _refuse_if(argument: int, value: int, beside: int, flags: int) -> Program:
    """Refuse the value if the argument `beside` has one of the `flags`; otherwise continue."""
    return [
        _op(LOAD, _at(argument)),
        _op(EQUAL, value, 0, 3),
        _op(LOAD, _at(beside)),
        _op(SET, flags, 0, 1),
        _op(RETURN, REFUSE | errno.EPERM),
    ]


def _opens_to_read(flags: int) -> Program:
    return [_op(LOAD, _at(flags)), _op(SET, CHANGING, 0, 1), *ENDS]


def _refuse_truncation(flags: int) -> Program:
    """Refuse to truncate a file that is opened for reading, which Landlock before its version 3 allows."""
    return [_op(LOAD, _at(flags)), _op(SET, os.O_TRUNC, 0, 2), _op(SET, WRITING, 1, 0), *ENDS]


def _require_null(argument: int) -> Program:
    """Allow the call only if the pointer, in both halves, is null."""
    low, high = _at(argument), _at(argument) + 4
    return [_op(LOAD, low), _op(EQUAL, 0, 0, 2), _op(LOAD, high), _op(EQUAL, 0, 1, 0), *ENDS]


def _at(argument: int) -> int:
    """Return the offset of the lower half of an argument; both machines are little-endian."""
    return ARGUMENTS_AT + 8 * argument


def _op(code: int, value: int, if_true: int = 0, if_false: int = 0) -> bytes:
    return struct.pack("<HBBI", code, if_true, if_false, value)


ENDS = (_op(RETURN, REFUSE | errno.EPERM), _op(RETURN, ALLOW))  # the end of a block: refused, or, skipping one, allowed
