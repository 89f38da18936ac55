"""The `stone` command: words, options, progress and exit codes around the pipelines.

**Conventions.** The wheel holds the packages that the client stands on in `_vendor`, so an environment gets one import
root. That folder comes last on the path: if the platform is installed beside the client, its packages are the ones
that are imported, once. A checkout has no such folder.
"""

import sys
from pathlib import Path

_VENDOR = Path(__file__).with_name("_vendor")
if _VENDOR.is_dir():
    sys.path.append(str(_VENDOR))
