"""On import, ends the process if its settings are refused: it logs one line with the reason, exit code 1.

**Conventions.** For entry points, before any module that uses the settings: Celery's application does so when it is
loaded.
"""

import sys

import structlog

from services.runtime.settings import Settings
from services.runtime.telemetry.log_lines import speak_json
from stone.errors import StoneError

try:
    Settings()
except StoneError as refusal:
    speak_json()
    structlog.get_logger(__name__).error("not started", code=refusal.code, reason=str(refusal))
    sys.exit(1)
