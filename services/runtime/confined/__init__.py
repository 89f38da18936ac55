"""Work on hostile bytes in a forked child with limits: `confined(work, limits, watch)`.

**Conventions.** `running` is the parent's side and says what holds, `child` the child's, `words` what they speak.
"""

from services.runtime.confined.child import Limits, Progress
from services.runtime.confined.errors import ConfinedCrashedError, ConfinedInterruptedError
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
