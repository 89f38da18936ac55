"""What the broker may tell a worker: that there is work."""

from typing import Any
from unittest.mock import Mock

from kombu.utils.imports import symbol_by_name

from services.runtime.jobs.broker_app import make_app
from services.runtime.settings import Settings


def test_nobody_steers_or_watches_workers_by_the_broker() -> None:
    said = make_app(Settings()).conf
    assert not said.worker_enable_remote_control
    assert not said.worker_send_task_events
    assert not said.task_send_sent_event
    assert {*said.accept_content} == {"json"}, "what is unpickled may be anything"


def test_a_message_sets_no_limit_of_its_own() -> None:
    app = make_app(Settings())

    @app.task(name="ingest.work")  # type: ignore[untyped-decorator]
    def work() -> None: ...

    kind: Any = symbol_by_name(app.tasks["ingest.work"].Request)
    message = Mock(headers={"id": "1", "task": "ingest.work", "timelimit": [0.2, 0.1]}, body=([], {}, {}))
    made = kind(message, app=app, task=app.tasks["ingest.work"], headers=message.headers, decoded=True)
    assert made.time_limits == (None, None)
