"""Isolation of a sandboxed child: network, processes and writing, by the best available kernel mechanism.

| fence     | by seccomp                      | otherwise by                         |
|-----------|---------------------------------|--------------------------------------|
| network   | no socket at all                | its own user and network namespace; Landlock: no TCP |
| processes | no fork, exec, trace or signal  | Landlock: no signal; its own user if root runs the service |
| writing   | no file is opened for writing   | Landlock; without a folder, a file size limit of zero |
| reading   | nothing                         | Landlock: only the given files and the system's own files |

**Conventions.** A child may have one folder to write in and files to read; Landlock enforces this, and without Landlock
only the file modes do. Each fence uses the strongest mechanism of this kernel; none needs a privilege. The child
reports its mechanisms to its parent, which logs them once, so a missing fence is always visible. Only a container's own
seccomp profile may forbid the namespace; Docker's and podman's default profiles allow `seccomp` and `landlock_*`.
"""

import ctypes
import os
import stat
import struct
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from services.runtime.sandbox import seccomp
from services.runtime.sandbox.limits import SandboxLimits
from services.runtime.sandbox.system_files import DEVICES, system_files

NONE = "none"
CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000

SandboxMechanisms = Mapping[str, str]
_LIBC = ctypes.CDLL(None, use_errno=True)


def enter_sandbox(limits: SandboxLimits) -> SandboxMechanisms:
    """Isolate this process; return the mechanism of each fence, `none` for a missing fence.

    The isolation cannot be undone. Raises `RuntimeError` if the process has several threads, which would stay outside.
    """
    if len(os.listdir("/proc/self/task")) > 1:
        raise RuntimeError("a process of several threads cannot enter the sandbox")
    folder = limits.folder
    has_landlock = restrict_files(limits)
    has_seccomp = seccomp.allow_calls(seccomp.kind_of(limits))
    network = "seccomp" if has_seccomp else "namespace" if _leave_the_network() else NONE
    by_size = "file size" if folder is None else NONE
    writing = "landlock" if has_landlock else "seccomp" if has_seccomp and folder is None else by_size
    processes, reading = "seccomp" if has_seccomp else NONE, "landlock" if has_landlock else NONE
    return {"network": network, "processes": processes, "writing": writing, "reading": reading}


def missing_fences() -> Mapping[str, str]:
    """Return the consequence of each fence, by name, that this kernel or the container around it does not provide."""
    spoken, missing = version(), {}
    if not seccomp.is_known():
        missing["no_seccomp"] = (
            "a child that a damaged file takes over can start processes and signal processes of its user; "
            "check that the container's profile allows seccomp(2)."
        )
    if spoken == 0:
        missing["no_landlock"] = (
            "a child that a damaged file takes over can read (and with a folder, write) all files of its user. "
            "Landlock requires Linux 5.13 or later with landlock in its list of security modules (lsm=)."
        )
    elif spoken < WITH_SCOPES:
        missing["landlock_without_signals"] = (
            f"only seccomp prevents a child from signalling processes of its user: Landlock has version {spoken} here, "
            f"and prevents signals from version {WITH_SCOPES} on (Linux 6.12)."
        )
    return missing


def replace_inherited_descriptors(*kept: int | None) -> None:
    """Replace the parent's descriptors by the empty device, except standard output, error and `kept`.

    Closing them instead would be unsafe: an object of the parent might close a later file with the same number.
    """
    held = [int(name) for name in os.listdir("/proc/self/fd")]
    nothing = os.open(os.devnull, os.O_RDONLY)
    for number in held:
        if number not in (1, 2, nothing, *kept):
            os.dup2(nothing, number, inheritable=False)


def _leave_the_network() -> bool:
    """Enter namespaces without any interface as the same user (an unknown user cannot create inodes there)."""
    user, group = os.getuid(), os.getgid()
    if _LIBC.unshare(CLONE_NEWUSER | CLONE_NEWNET) != 0:
        return False
    with suppress(OSError):  # without the mapping, only writing files fails
        for name, content in (
            ("setgroups", "deny"),
            ("uid_map", f"{user} {user} 1"),
            ("gid_map", f"{group} {group} 1"),
        ):
            Path("/proc/self", name).write_text(content)
    return True


# Landlock rules: a sandboxed child writes below one folder only, reads its given files and the system's own, has no
# network, and cannot signal or trace processes outside.
#
# **Conventions.** Linux 5.13 and later (landlock(7)); rights that a kernel does not support are left out. The rules
# also bind root, cannot be removed, and need no privilege. Two rules protect the `/proc` entries of other processes:
# they are not among the files, and tracing processes outside the domain is forbidden (ptrace(2), access mode checks).


CREATE, ADD, RESTRICT = 444, 445, 446  # the same on every machine
VERSION_ASKED, BENEATH = 1, 1
PR_SET_NO_NEW_PRIVS = 38
EXECUTE, WRITE_FILE, READ_FILE, READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
REFER, TRUNCATE, IOCTL_DEV = 1 << 13, 1 << 14, 1 << 15
MAKING = sum(1 << bit for bit in range(4, 13))  # remove_dir, remove_file, make_char to make_sym
REGULAR = sum(1 << bit for bit in (4, 5, 7, 8))  # the bits for folders and files
MAKE_SYM = 1 << 12
OF_FILES = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE | IOCTL_DEV  # all other rights apply to folders
SINCE = {1: EXECUTE | WRITE_FILE | READ_FILE | READ_DIR | MAKING, 2: REFER, 3: TRUNCATE, 5: IOCTL_DEV}
TCP = 0b11  # bind and connect, since version 4
SCOPES, WITH_SCOPES = 0b11, 6  # abstract sockets and signals, since that version


def version() -> int:
    """Return the Landlock version of this kernel; 0 if Landlock is missing or disabled."""
    return max(0, int(_LIBC.syscall(CREATE, None, ctypes.c_size_t(0), VERSION_ASKED)))


def restrict_files(limits: SandboxLimits) -> bool:
    """Restrict this process to the files of `limits` and of the system; return whether the kernel accepted it."""
    spoken = version()
    if spoken == 0 or _LIBC.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        return False
    held = sum(rights for since, rights in SINCE.items() if since <= spoken)
    rules = struct.pack("<QQQ", held, TCP, SCOPES)[: 8 if spoken < 4 else 16 if spoken < WITH_SCOPES else 24]
    ruleset = _LIBC.syscall(CREATE, rules, ctypes.c_size_t(len(rules)), 0)
    if ruleset < 0:
        return False
    try:
        for path, rights in _list_allowed(limits):
            with suppress(FileNotFoundError):
                if not _allow(ruleset, path, held & rights):
                    return False
        return bool(_LIBC.syscall(RESTRICT, ruleset, 0) == 0)
    finally:
        os.close(ruleset)


def _list_allowed(limits: SandboxLimits) -> Iterable[tuple[Path, int]]:
    """Yield the allowed paths and their rights."""
    reading = READ_FILE | READ_DIR
    yield from ((path, reading) for path in (*system_files(), *limits.reads))
    yield from ((path, READ_FILE | WRITE_FILE) for path in DEVICES)
    if limits.folder is not None:
        links = MAKE_SYM if limits.makes_links else 0
        yield limits.folder, reading | WRITE_FILE | REGULAR | REFER | TRUNCATE | links


def _allow(ruleset: int, path: Path, rights: int) -> bool:
    """Add a rule for a path. Raises `FileNotFoundError`."""
    below = os.open(path, os.O_PATH)
    try:
        is_folder = stat.S_ISDIR(os.fstat(below).st_mode)
        rule = struct.pack("<Qi", rights if is_folder else rights & OF_FILES, below)
        return bool(_LIBC.syscall(ADD, ruleset, BENEATH, rule, 0) == 0)
    finally:
        os.close(below)
