"""The central directory of a submission's zip: converts faults of `stone_files/zip_directory.py` to submission
errors.
"""

from collections.abc import Iterator
from contextlib import contextmanager

from stone_files import zip_directory
from stone_files.zip_directory import IN_EXTRA_32, ReadAt, ZipFaultError, ZipMember
from stone_submissions.errors import SubmissionError

__all__ = ["IN_EXTRA_32", "ReadAt", "ZipMember", "payload_span", "read_directory"]


def read_directory(read_at: ReadAt, size_bytes: int, max_entries: int) -> tuple[ZipMember, ...]:
    """Return the members in directory order. Raises a `SubmissionError` with the same code."""
    with _faults_of_submissions():
        return zip_directory.read_directory(read_at, size_bytes, max_entries)


def payload_span(read_at: ReadAt, member: ZipMember) -> tuple[int, int]:
    """Return start and stop of the packed bytes of `member`. Raises a `SubmissionError` with the same code."""
    with _faults_of_submissions():
        return zip_directory.payload_span(read_at, member)


@contextmanager
def _faults_of_submissions() -> Iterator[None]:
    try:
        yield
    except ZipFaultError as fault:
        raise SubmissionError(fault.code, fault.expected, fault.actual) from fault
