"""A seccomp filter that denies a sandboxed child the network, other processes and, if asked, all writing.

**Conventions.** Classic BPF over `struct seccomp_data` (seccomp(2)): what is refused is answered EPERM, so that the
child sees an error like any other; calls by another machine's numbers end it. The filter cannot be taken off again and
holds for root too. It lists what is refused, not what is allowed: numerical libraries and allocators differ in what
they call, and what is left after this list reaches nothing but the child's own memory and files it may read.

`clone3` keeps its flags in memory that no filter can read, so it is answered ENOSYS and the C library takes `clone`,
of which threads pass and processes do not. A signal goes to the child itself only. Limits may be read, not raised. A
pair of local sockets passes: a library's event loop wakes itself by one, and it leads nowhere else.
"""

import ctypes
import errno
import os
import socket
import struct
from collections.abc import Iterable, Mapping

from services.runtime.sandbox.syscalls import FILES, LINKS, MACHINE, NETWORK, NUMBERS, OWNERSHIP, PROCESSES

AUDIT_ARCH = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
CALL = {"x86_64": 317, "aarch64": 277}  # seccomp(2) itself
SET_MODE_FILTER, SPEC_ALLOW = 1, 1 << 2  # without the latter older kernels slow the child's branches down
PR_SET_NO_NEW_PRIVS = 38
X32_BIT = 0x4000_0000
ALLOW, KILL, REFUSE = 0x7FFF0000, 0x80000000, 0x00050000
LOAD, EQUAL, SET, AT_LEAST, RETURN = 0x20, 0x15, 0x45, 0x35, 0x06
NUMBER_AT, ARCH_AT, ARGUMENTS_AT = 0, 4, 16
CLONE_THREAD = 0x10000
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
TIOCSTI = 0x5412  # types on the terminal that a command was started from

Program = list[bytes]
_LIBC = ctypes.CDLL(None, use_errno=True)


class _Filter(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_char_p))


def refuse_calls(*, may_write: bool, may_link: bool = False) -> bool:
    """Put the filter on this process, whose threads to come have it too; whether the kernel took it.

    With `may_write` the calls that make and change files pass (Landlock says where), with `may_link` links as well.
    """
    machine = os.uname().machine
    if machine not in NUMBERS or _LIBC.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        return False
    program = program_of(machine, os.getpid(), may_write=may_write, may_link=may_link)
    taken = _Filter(len(program), b"".join(program))
    return bool(_LIBC.syscall(CALL[machine], SET_MODE_FILTER, SPEC_ALLOW, ctypes.byref(taken)) == 0)


def program_of(machine: str, pid: int, *, may_write: bool, may_link: bool = False) -> Program:
    """The filter for the process `pid`, an instruction an entry."""
    numbers = NUMBERS[machine]
    head = [_op(LOAD, ARCH_AT), _op(EQUAL, AUDIT_ARCH[machine], 1, 0), _op(RETURN, KILL), _op(LOAD, NUMBER_AT)]
    if machine == "x86_64":
        head += [_op(AT_LEAST, X32_BIT, 0, 1), _op(RETURN, KILL)]
    refused = [*NETWORK, *PROCESSES, *MACHINE, *OWNERSHIP]
    refused += [*([] if may_write else FILES), *([] if may_write and may_link else LINKS)]
    body = [*_refused(numbers, refused), *_without(numbers, ("clone3", "openat2"), errno.ENOSYS)]
    for name, block in _blocks(pid, may_write=may_write).items():
        if name in numbers:
            body += [_op(EQUAL, numbers[name], 0, len(block)), *block]
    return [*head, *body, _op(RETURN, ALLOW)]


def _refused(numbers: Mapping[str, int], names: Iterable[str]) -> Program:
    return _without(numbers, names, errno.EPERM)


def _without(numbers: Mapping[str, int], names: Iterable[str], answer: int) -> Program:
    """Each call by itself: a jump reaches 255 instructions, and the kernel remembers what always passes."""
    return [
        op
        for name in names
        if name in numbers
        for op in (_op(EQUAL, numbers[name], 0, 1), _op(RETURN, REFUSE | answer))
    ]


def _blocks(pid: int, *, may_write: bool) -> dict[str, Program]:
    """Calls that pass or not by what they are given."""
    to_itself = _if(0, _op(EQUAL, pid, 1, 0))
    blocks = {
        "socketpair": _if(0, _op(EQUAL, socket.AF_UNIX, 1, 0)),
        "clone": _if(0, _op(SET, CLONE_THREAD, 1, 0)),
        "kill": to_itself,
        "tgkill": to_itself,
        "prlimit64": _reads_only(2),
        "ioctl": _if(1, _op(EQUAL, TIOCSTI, 0, 1)),
    }
    if not may_write:
        blocks |= {"open": _if(1, _op(SET, WRITING, 0, 1)), "openat": _if(2, _op(SET, WRITING, 0, 1))}
    return blocks


def _if(argument: int, test: bytes) -> Program:
    """Refused where `test` of the argument's lower half goes on, allowed where it skips one."""
    return [_op(LOAD, _at(argument)), test, _op(RETURN, REFUSE | errno.EPERM), _op(RETURN, ALLOW)]


def _reads_only(argument: int) -> Program:
    """Allowed where the pointer, both its halves, is none."""
    low, high = _at(argument), _at(argument) + 4
    return [
        _op(LOAD, low),
        _op(EQUAL, 0, 0, 2),
        _op(LOAD, high),
        _op(EQUAL, 0, 1, 0),
        _op(RETURN, REFUSE | errno.EPERM),
        _op(RETURN, ALLOW),
    ]


def _at(argument: int) -> int:
    """The offset of the lower half of an argument; both machines are little-endian."""
    return ARGUMENTS_AT + 8 * argument


def _op(code: int, value: int, if_true: int = 0, if_false: int = 0) -> bytes:
    return struct.pack("<HBBI", code, if_true, if_false, value)
