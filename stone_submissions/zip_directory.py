"""The table of contents of a submission's zip: faults of `stone_files/zip_directory.py` as those of submissions."""

from collections.abc import Iterator
from contextlib import contextmanager

from stone_files import zip_directory
from stone_files.zip_directory import IN_EXTRA_32, ReadAt, ZipFaultError, ZipMember
from stone_submissions.errors import SubmissionError

__all__ = ["IN_EXTRA_32", "ReadAt", "ZipMember", "payload_span", "read_directory"]


def read_directory(read_at: ReadAt, size_bytes: int, max_entries: int) -> tuple[ZipMember, ...]:
    """Return the members in the order of the directory. Raises a `SubmissionError` of the same code."""
    with _faults_of_submissions():
        return zip_directory.read_directory(read_at, size_bytes, max_entries)


def payload_span(read_at: ReadAt, member: ZipMember) -> tuple[int, int]:
    """Return where the packed bytes of `member` start and stop. Raises a `SubmissionError` of the same code."""
    with _faults_of_submissions():
        return zip_directory.payload_span(read_at, member)


@contextmanager
def _faults_of_submissions() -> Iterator[None]:
    try:
        yield
    except ZipFaultError as fault:
        raise SubmissionError(fault.code, fault.expected, fault.actual) from fault
