"""Every line a process says is one JSON object, with what belongs to the request and without secrets."""

import json
import subprocess
import sys

PROGRAM = """
import logging, structlog
from services.runtime.telemetry.log_lines import speak_json
speak_json()
speak_json()
log = structlog.get_logger("ours")
with structlog.contextvars.bound_contextvars(request_id="r-7"):
    log.info("said", count=3, odd=object())
    logging.getLogger("uvicorn.error").warning("theirs %s", 1)
    logging.getLogger("uvicorn.access").info("GET /?cursor=whole")
log.debug("too quiet")
def fail(password):
    return 1 / 0
try:
    fail("hunter2")
except ZeroDivisionError as error:
    log.error("fault", exc_info=error)
"""


def test_ours_and_the_libraries_lines_are_json_with_the_request() -> None:
    ended = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True)
    assert ended.stdout == ""
    said, theirs, fault = [json.loads(line) for line in ended.stderr.splitlines()]
    assert (said["event"], said["count"], said["request_id"], said["level"]) == ("said", 3, "r-7", "info")
    assert said["timestamp"].endswith("Z")
    assert (theirs["event"], theirs["logger"], theirs["request_id"]) == ("theirs 1", "uvicorn.error", "r-7")
    assert fault["exception"][0]["exc_type"] == "ZeroDivisionError"
    assert "request_id" not in fault
    assert "hunter2" not in ended.stderr
    assert "cursor" not in ended.stderr
