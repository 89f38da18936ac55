"""Who is told what: those who chose it and may see it when it is sent, of each event once."""

from pathlib import Path
from collections.abc import Iterator

import pytest

from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.states import end
from services.domain.notifications.choices import choose
from services.domain.notifications.phase_clock import LATEST_NS, tell_phases
from services.domain.sequences.unusable_labels import tell_unusable
from services.maintenance.notifications.delivery import deliver_queued
from services.domain.notifications.spread import spread_events
from services.runtime.access import storage_quota
from services.runtime.access.erasure import erase_user
from services.runtime.jobs.enqueue import enqueue, enqueue_run
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.notifications.events import PHASE_OPENED, RUN_DONE, SUBMISSION_SCORED, NewEvent, record
from services.runtime.orm import (
    NotificationDelivery, NotificationEvent, Phase, SequenceRow, SubmissionRow, TeamMember, User, Webhook, Benchmark, Dataset,
)
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.servers.webhook_receiver import WebhookReceiver, webhook_receiver
from tests.services.maintenance.notifications.steps import a_user, deliveries, happened, telling, turn
from tests.services.runtime.jobs.steps import a_job, a_run, run_all
