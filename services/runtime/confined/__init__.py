"""Work on hostile bytes in a forked child, shut in: `confined(work, limits, watch)`.

**Conventions.** `running` is the parent's side and says what holds, `child` the child's, `words` what they speak.
`limits` says how much the child may take, `fences` what it cannot reach (`seccomp`, `landlock`) and on which kernels.
"""

from services.runtime.confined.child import Progress
from services.runtime.confined.errors import ConfinedCrashedError, ConfinedInterruptedError
from services.runtime.confined.limits import Limits
from services.runtime.confined.running import LIMITS, UNWATCHED, Watch, confined, confined_telling

__all__ = [
    "LIMITS",
    "UNWATCHED",
    "ConfinedCrashedError",
    "ConfinedInterruptedError",
    "Limits",
    "Progress",
    "Watch",
    "confined",
    "confined_telling",
]
