"""A sandbox for untrusted bytes: work runs in a forked child process behind fences.

**Conventions.** `parent` is the parent's side and documents the guarantees, `child` is the child's side, `messages`
their protocol, `answers` the models of valid answers. `limits` bounds the child's resources, `fences` isolates it by
kernel mechanisms (`seccomp` with the list in `system_calls`); `fork_server` forks it.
"""

from services.runtime.sandbox.child import ProgressCallback
from services.runtime.sandbox.errors import SandboxCrashedError, SandboxInterruptedError
from services.runtime.sandbox.limits import SandboxLimits
from services.runtime.sandbox.parent import LIMITS, UNWATCHED, SandboxWatch, sandboxed, sandboxed_with_progress

__all__ = [
    "LIMITS",
    "UNWATCHED",
    "ProgressCallback",
    "SandboxCrashedError",
    "SandboxInterruptedError",
    "SandboxLimits",
    "SandboxWatch",
    "sandboxed",
    "sandboxed_with_progress",
]
