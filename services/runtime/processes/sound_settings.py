"""Importing this ends the process whose settings are refused: one line that says why, exit code 1.

**Conventions.** For entry points, before whatever makes something of the settings: Celery's application does when it is
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
