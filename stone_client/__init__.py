"""The `stone` command and its SDK: `from stone_client import Stone`.

**Conventions.** The wheel contains the packages that the client requires in `_vendor`, so an environment gets one
import root. If the platform is installed beside the client, that folder comes last on the path, so Python imports the
platform's packages. Otherwise it comes first, because another distribution owns a package `stone` too. A checkout has
no such folder.
"""

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stone_client.sdk import Stone as Stone

__all__ = ["Stone"]

_VENDOR = Path(__file__).with_name("_vendor")
if _VENDOR.is_dir() and str(_VENDOR) not in sys.path:
    sys.path.insert(len(sys.path) if find_spec("stone_local") else 0, str(_VENDOR))


def __getattr__(name: str) -> Any:
    """Return a name of the SDK, loaded at its first use so that commands without the SDK start faster. Raises
    AttributeError.
    """
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from stone_client import sdk

    return getattr(sdk, name)
