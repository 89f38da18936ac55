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


# System call numbers that the sandbox denies, by machine and by effect.
#
# **Conventions.** `NUMBERS[machine][name]`, `machine` as `os.uname().machine` says it; from the kernel's own headers
# (`asm/unistd_64.h` for x86_64, `asm-generic/unistd.h` for aarch64, which never had the older calls). A group is
# names; a name that a machine does not have is not refused there, since nobody can call it.


def _names(words: str) -> tuple[str, ...]:
    return tuple(words.split())


NETWORK = _names(
    """
    socket connect bind listen accept accept4 sendto sendmsg sendmmsg recvfrom recvmsg recvmmsg
    """
)
PROCESSES = _names(
    """
    fork vfork execve execveat tkill rt_sigqueueinfo rt_tgsigqueueinfo pidfd_open pidfd_send_signal pidfd_getfd
    ptrace process_vm_readv process_vm_writev process_madvise setrlimit shmget shmat msgget semget mq_open
    """
)
MACHINE = _names(
    """
    mount umount2 pivot_root chroot unshare setns move_mount open_tree fsopen fsmount mount_setattr swapon swapoff
    acct quotactl quotactl_fd bpf perf_event_open userfaultfd io_uring_setup io_uring_enter io_uring_register keyctl
    add_key request_key init_module finit_module delete_module kexec_load kexec_file_load reboot syslog personality
    iopl ioperm setuid setgid setreuid setregid setresuid setresgid setgroups setfsuid setfsgid capset sethostname
    setdomainname settimeofday clock_settime adjtimex clock_adjtime name_to_handle_at open_by_handle_at
    fanotify_init
    """
)
OWNERSHIP = _names(
    """
    mknod mknodat chown fchown lchown fchownat setxattr lsetxattr fsetxattr removexattr lremovexattr fremovexattr
    utime utimes utimensat futimesat
    """
)
FILES = _names(
    """
    creat truncate rename renameat renameat2 unlink unlinkat mkdir mkdirat rmdir chmod fchmod fchmodat fchmodat2
    """
)
LINKS = _names("link linkat symlink symlinkat")

_X86_64 = """
    socket 41 socketpair 53 connect 42 bind 49 listen 50 accept 43 accept4 288 sendto 44 sendmsg 46 sendmmsg 307
    recvfrom 45 recvmsg 47 recvmmsg 299 fork 57 vfork 58 clone 56 clone3 435 execve 59 execveat 322 kill 62 tkill 200
    tgkill 234 rt_sigqueueinfo 129 rt_tgsigqueueinfo 297 pidfd_open 434 pidfd_send_signal 424 pidfd_getfd 438 ptrace 101
    process_vm_readv 310 process_vm_writev 311 process_madvise 440 prlimit64 302 setrlimit 160 ioctl 16 open 2
    openat 257 openat2 437 creat 85 truncate 76 rename 82 renameat 264 renameat2 316 link 86 linkat 265 symlink 88
    symlinkat 266 unlink 87 unlinkat 263 mkdir 83 mkdirat 258 rmdir 84 mknod 133 mknodat 259 chmod 90 fchmod 91
    fchmodat 268 fchmodat2 452 chown 92 fchown 93 lchown 94 fchownat 260 setxattr 188 lsetxattr 189 fsetxattr 190
    removexattr 197 lremovexattr 198 fremovexattr 199 utime 132 utimes 235 utimensat 280 futimesat 261
    open_by_handle_at 304 name_to_handle_at 303 mount 165 umount2 166 pivot_root 155 chroot 161 unshare 272 setns 308
    move_mount 429 open_tree 428 fsopen 430 fsmount 432 mount_setattr 442 swapon 167 swapoff 168 acct 163 quotactl 179
    quotactl_fd 443 bpf 321 perf_event_open 298 userfaultfd 323 io_uring_setup 425 io_uring_enter 426
    io_uring_register 427 keyctl 250 add_key 248 request_key 249 init_module 175 finit_module 313 delete_module 176
    kexec_load 246 kexec_file_load 320 reboot 169 syslog 103 personality 135 iopl 172 ioperm 173 setuid 105 setgid 106
    setreuid 113 setregid 114 setresuid 117 setresgid 119 setgroups 116 setfsuid 122 setfsgid 123 capset 126
    sethostname 170 setdomainname 171 settimeofday 164 clock_settime 227 adjtimex 159 clock_adjtime 305 shmget 29
    shmat 30 msgget 68 semget 64 mq_open 240 fanotify_init 300
"""
_AARCH64 = """
    socket 198 socketpair 199 connect 203 bind 200 listen 201 accept 202 accept4 242 sendto 206 sendmsg 211 sendmmsg 269
    recvfrom 207 recvmsg 212 recvmmsg 243 clone 220 clone3 435 execve 221 execveat 281 kill 129 tkill 130 tgkill 131
    rt_sigqueueinfo 138 rt_tgsigqueueinfo 240 pidfd_open 434 pidfd_send_signal 424 pidfd_getfd 438 ptrace 117
    process_vm_readv 270 process_vm_writev 271 process_madvise 440 prlimit64 261 setrlimit 164 ioctl 29 openat 56
    openat2 437 truncate 45 renameat 38 renameat2 276 linkat 37 symlinkat 36 unlinkat 35 mkdirat 34 mknodat 33 fchmod 52
    fchmodat 53 fchmodat2 452 fchown 55 fchownat 54 setxattr 5 lsetxattr 6 fsetxattr 7 removexattr 14 lremovexattr 15
    fremovexattr 16 utimensat 88 open_by_handle_at 265 name_to_handle_at 264 mount 40 umount2 39 pivot_root 41 chroot 51
    unshare 97 setns 268 move_mount 429 open_tree 428 fsopen 430 fsmount 432 mount_setattr 442 swapon 224 swapoff 225
    acct 89 quotactl 60 quotactl_fd 443 bpf 280 perf_event_open 241 userfaultfd 282 io_uring_setup 425
    io_uring_enter 426 io_uring_register 427 keyctl 219 add_key 217 request_key 218 init_module 105 finit_module 273
    delete_module 106 kexec_load 104 kexec_file_load 294 reboot 142 syslog 116 personality 92 setuid 146 setgid 144
    setreuid 145 setregid 143 setresuid 147 setresgid 149 setgroups 159 setfsuid 151 setfsgid 152 capset 91
    sethostname 161 setdomainname 162 settimeofday 170 clock_settime 112 adjtimex 171 clock_adjtime 266 shmget 194
    shmat 196 msgget 186 semget 190 mq_open 180 fanotify_init 262
"""


def _numbers(table: str) -> dict[str, int]:
    words = table.split()
    return {name: int(number) for name, number in zip(words[::2], words[1::2], strict=True)}


NUMBERS = {"x86_64": _numbers(_X86_64), "aarch64": _numbers(_AARCH64)}
