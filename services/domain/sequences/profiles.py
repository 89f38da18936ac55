"""Topic profiles in the database: the topic of each role, one profile per owner and robot platform.

**Conventions.** Part of the caller's transaction. The owner's row is locked first, so that concurrent changes are
serialised. A run's arguments contain its topics, so a change affects no existing labels.
"""

from collections.abc import Mapping

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import ProfileRow, SequenceRow, User


def profile_of(session: Session, owner_id: str, platform: str) -> ProfileRow | None:
    """Return the owner's profile for the platform, or None."""
    of_platform = select(ProfileRow).where(ProfileRow.owner_id == owner_id, ProfileRow.platform == platform)
    return session.scalars(of_platform.execution_options(populate_existing=True)).one_or_none()


def lock_profile(session: Session, owner_id: str, platform: str) -> ProfileRow | None:
    """Return the same, locked against changes and creation until the end of the transaction."""
    session.execute(select(User.id).where(User.id == owner_id).with_for_update(key_share=True))
    return profile_of(session, owner_id, platform)


def keep_profile(session: Session, profile: ProfileRow, topics: Mapping[str, str]) -> bool:
    """Set the topics of the profile, adding it if it is new; return whether it changed."""
    if profile.id is None:
        profile.topics = dict(topics)
        session.add(profile)
        session.flush()
        return True
    if profile.topics == topics:
        return False
    profile.topics, profile.revision = dict(topics), profile.revision + 1
    return True


def topics_of(session: Session, sequence: SequenceRow) -> dict[str, str]:
    """Return the owner's topics for the sequence's platform, {} without a platform or a profile."""
    profile = profile_of(session, sequence.owner_id, sequence.platform) if sequence.platform else None
    return dict(profile.topics) if profile is not None else {}
