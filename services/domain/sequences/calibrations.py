"""Calibrations in the database: immutable, versioned by owner and name, deduplicated by content.

**Conventions.** Part of the caller's transaction. The owner's row is locked first, so that concurrent files become
consecutive versions. The bytes are stored before the transaction (`blobs.prepare`).
"""

from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from services.runtime.orm import CalibrationRow, User
from services.runtime.store.blobs import PreparedBlob, link


@dataclass(frozen=True)
class Validity:
    """[from, to), nanoseconds since 1970; None: open on that side."""

    from_ns: int | None = None
    to_ns: int | None = None


ALWAYS = Validity()


@dataclass(frozen=True)
class ReadCalibration:
    """A parsed and accepted calibration file, with the content of its list entry."""

    name: str
    filename: str
    sensors: tuple[dict[str, str], ...]
    findings: tuple[dict[str, str], ...]
    format: str = "native"
    validity: Validity = ALWAYS


def add_calibration(
    session: Session, owner_id: str, read: ReadCalibration, blob: PreparedBlob
) -> tuple[CalibrationRow, bool]:
    """Add the next version of the owner's calibration with this name; return its row and whether it is new.

    If a version has equal content and validity, it is returned instead. Equal bytes with another validity are another
    version, since versions never change.
    """
    session.execute(select(User.id).where(User.id == owner_id).with_for_update(key_share=True))
    same = select(CalibrationRow).where(
        CalibrationRow.owner_id == owner_id,
        CalibrationRow.sha256 == blob.sha256,
        CalibrationRow.valid_from_ns.is_not_distinct_from(read.validity.from_ns),
        CalibrationRow.valid_to_ns.is_not_distinct_from(read.validity.to_ns),
    )
    standing = session.scalars(same).first()
    if standing is not None:
        return standing, False
    row = link(session, blob)
    of_name = select(func.max(CalibrationRow.version)).where(
        CalibrationRow.owner_id == owner_id, CalibrationRow.name == read.name
    )
    calibration = CalibrationRow(
        owner_id=owner_id,
        name=read.name,
        version=(session.scalar(of_name) or 0) + 1,
        filename=read.filename,
        sha256=row.sha256,
        blob_sha256=row.sha256,
        sensors=list(read.sensors),
        findings=list(read.findings),
        format=read.format,
        valid_from_ns=read.validity.from_ns,
        valid_to_ns=read.validity.to_ns,
    )
    session.add(calibration)
    session.flush()
    return calibration, True
