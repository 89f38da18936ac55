"""Children that read calibrations and class maps import nothing: reading 41 bytes must not load the API.

Catches alone a child's work that stands beside routes and views, which cost each upload seconds.
"""

import subprocess
import sys

from api.main import FORKED_FROM
from api.views import calibration_reading
from api.views.imports import class_maps
from services.runtime.sandbox.fork_server import load_first

HEAVY = ("fastapi", "starlette", "sqlalchemy", "services.domain", "api.views", "api.routes", "numba")


def test_the_works_of_children_stand_in_what_the_fork_server_loads_first() -> None:
    load_first(FORKED_FROM)
    works = (calibration_reading.calibration_read, class_maps.class_map_read)
    assert {work.__module__ for work in works} <= set(FORKED_FROM)


def test_what_the_fork_server_loads_first_is_no_part_of_the_api() -> None:
    line = f"import sys; from services.runtime.sandbox.fork_server import load_first; load_first({FORKED_FROM!r}); "
    code = line + f"print(*[name for name in {HEAVY!r} if name in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.split() == []
