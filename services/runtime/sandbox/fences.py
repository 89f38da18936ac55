"""Isolation of a sandboxed child: network, processes and writing, by whichever kernel mechanism there is.

| fence     | by seccomp                      | else by                              |
|-----------|---------------------------------|--------------------------------------|
| network   | no socket at all                | a user and network namespace of its own; Landlock: no TCP |
| processes | no fork, exec, trace or signal  | nothing                              |
| writing   | no file is opened for writing   | Landlock; else a file size of zero, where no folder is given |
| reading   | nothing                         | Landlock: what was given, and the system's own files |

**Conventions.** A child may be given one folder to write in and files to read; Landlock then keeps it there, and
without Landlock the file modes alone do. The strongest means are taken that this kernel has, none needs a privilege,
and the child tells its parent which they were, which is logged once: nobody is silently unprotected. Only a container's
own seccomp profile may forbid the namespace; Docker's and podman's default profiles allow `seccomp` and `landlock_*`.
"""

import ctypes
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from services.runtime.sandbox.landlock import restrict_files
from services.runtime.sandbox.limits import SandboxLimits
from services.runtime.sandbox.seccomp import refuse_calls

NONE = "none"
CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000

SandboxMechanisms = Mapping[str, str]
_LIBC = ctypes.CDLL(None, use_errno=True)


def enter_sandbox(limits: SandboxLimits) -> SandboxMechanisms:
    """Shut this process in; by which means each fence stands, `none` where it does not.

    The process has one thread. Nothing of this can be undone.
    """
    folder = limits.folder
    has_landlock = restrict_files(limits)
    has_seccomp = refuse_calls(may_write=folder is not None, may_link=limits.makes_links)
    network = "seccomp" if has_seccomp else "namespace" if _leave_the_network() else NONE
    by_size = "file size" if folder is None else NONE
    writing = "landlock" if has_landlock else "seccomp" if has_seccomp and folder is None else by_size
    processes, reading = "seccomp" if has_seccomp else NONE, "landlock" if has_landlock else NONE
    return {"network": network, "processes": processes, "writing": writing, "reading": reading}


def replace_inherited_descriptors(*kept: int | None) -> None:
    """Every connection and file of the parent becomes the empty device, but standard output, error and those `kept`.

    They are replaced, not closed: objects that believe to own a number would close what got it next.
    """
    held = [int(name) for name in os.listdir("/proc/self/fd")]
    nothing = os.open(os.devnull, os.O_RDONLY)
    for number in held:
        if number not in (1, 2, nothing, *kept):
            os.dup2(nothing, number, inheritable=False)


def _leave_the_network() -> bool:
    """Into namespaces without any interface, still the same user (an inode cannot be made by one unknown there)."""
    user, group = os.getuid(), os.getgid()
    if _LIBC.unshare(CLONE_NEWUSER | CLONE_NEWNET) != 0:
        return False
    with suppress(OSError):  # an identity that cannot be kept only shows in what it cannot write
        for name, content in (
            ("setgroups", "deny"),
            ("uid_map", f"{user} {user} 1"),
            ("gid_map", f"{group} {group} 1"),
        ):
            Path("/proc/self", name).write_text(content)
    return True
