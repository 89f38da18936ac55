"""The servers of the tests are real, keep what they were told through a kill, and never outlive their test run."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import boto3
import psycopg
import pytest
from botocore.exceptions import ClientError
from redis import Redis

from testing.process_states import is_running
from testing.servers.postgres import PostgresServer, running_postgres
from testing.servers.redis import running_redis
from testing.servers.s3 import S3Server
from testing.signals import hear_signals

START_ALL = """
import sys, time
from testing.servers.postgres import running_postgres
from testing.servers.redis import running_redis
from testing.servers.s3 import running_s3
with running_postgres() as postgres, running_redis() as redis, running_s3() as s3:
    print(postgres.pid, redis.pid, s3.pid, flush=True)
    print(postgres.folder, redis.folder, s3.folder, flush=True)
    time.sleep(600)
"""


def test_a_request_with_a_wrong_secret_is_refused(s3_server: S3Server) -> None:
    settings = s3_server.settings()
    client = boto3.client(
        "s3",
        endpoint_url=settings.s3_endpoint,
        region_name="us-east-1",
        aws_access_key_id=settings.s3_key_id,
        aws_secret_access_key="wrong",
    )
    with pytest.raises(ClientError, match="SignatureDoesNotMatch"):
        client.list_objects_v2(Bucket=settings.s3_bucket)


def test_two_databases_of_a_server_know_nothing_of_each_other(postgres_server: PostgresServer) -> None:
    with postgres_server.fresh_database() as one, postgres_server.fresh_database() as other:
        with psycopg.connect(one) as connection:
            connection.execute("CREATE TABLE mine (id int)")
        with psycopg.connect(other) as connection:
            found = connection.execute("SELECT to_regclass('mine')").fetchone()
    assert found == (None,)


def test_postgres_keeps_what_was_committed_through_a_kill() -> None:
    with running_postgres() as server:
        with psycopg.connect(server.url()) as connection:
            connection.execute("CREATE TABLE kept (id int)")
        server.kill()
        server.start()
        with psycopg.connect(server.url()) as connection:
            assert connection.execute("SELECT count(*) FROM kept").fetchone() == (0,)


def test_redis_keeps_what_was_queued_through_a_kill() -> None:
    with running_redis() as server, Redis.from_url(server.url) as client:
        client.rpush("queue", "job")
        server.kill()
        server.start()
        assert client.lrange("queue", 0, -1) == [b"job"]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_no_server_outlives_the_run_that_started_it(number: signal.Signals) -> None:
    command, pipe = [sys.executable, "-c", START_ALL], subprocess.PIPE
    run = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, preexec_fn=hear_signals)
    assert run.stdout is not None
    pids = [int(word) for word in run.stdout.readline().split()]
    folders = [Path(word) for word in run.stdout.readline().split()]
    assert len(pids) == len(folders) == 3
    run.send_signal(number)
    run.communicate(timeout=300)
    deadline_s = time.monotonic() + 300
    while any(is_running(pid) for pid in pids):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    if number == signal.SIGINT:
        assert not any(folder.exists() for folder in folders)
    for folder in folders:
        subprocess.run(["rm", "-rf", str(folder)], check=True)
