"""A profile of topics as a small YAML file, so that the choice made for one recording serves the next.

**Conventions.** `stone_profile: 1`, `platform:` and `topics:` by part. The file is from outside: plain YAML without
aliases and tags, at most 64 KiB.
"""

from pathlib import Path

from ruamel.yaml import YAML

from stone_files.atomic import atomic_file
from stone_recordings.calibrations.errors import CalibrationYamlError
from stone_recordings.calibrations.plain_yaml import parse_documents
from stone_recordings.topics.profile_errors import ProfileFileError
from stone_recordings.topics.profiles import TopicProfile

LARGEST_BYTES = 65_536
LONGEST_PLATFORM = 64
KEYS = {"stone_profile", "platform", "topics"}


def read_profile(path: Path) -> TopicProfile:
    """Raises ProfileFileError for what is no profile, BadProfileError for one that cannot be; OSError."""
    with path.open("rb") as stream:
        content = stream.read(LARGEST_BYTES + 1)
    if len(content) > LARGEST_BYTES:
        raise ProfileFileError(path.name, f"it has more than {LARGEST_BYTES} bytes")
    try:
        document = parse_documents(path.name, content)[0]
    except CalibrationYamlError as error:
        raise ProfileFileError(path.name, str(error)) from None
    if not isinstance(document, dict) or document.get("stone_profile") != 1:
        raise ProfileFileError(path.name, "it does not begin with `stone_profile: 1`")
    unknown = [str(key)[:40] for key in document if key not in KEYS]
    if unknown:
        raise ProfileFileError(path.name, f"it has the unknown key {unknown[0]!r}")
    platform, topics = document.get("platform", ""), document.get("topics")
    if not isinstance(platform, str) or len(platform) > LONGEST_PLATFORM:
        raise ProfileFileError(path.name, f"its platform is not text of at most {LONGEST_PLATFORM} characters")
    if not isinstance(topics, dict) or not all(isinstance(name, str) for pair in topics.items() for name in pair):
        raise ProfileFileError(path.name, "its topics are not names by role")
    return TopicProfile(topics, platform)


def write_profile(path: Path, profile: TopicProfile) -> None:
    """The file, whole or absent; an earlier one is replaced. Raises OSError."""
    yaml = YAML()
    yaml.width = 4096
    document = {"stone_profile": 1, "platform": profile.platform, "topics": dict(profile.topics)}
    with atomic_file(path) as staging, staging.open("w", encoding="utf-8") as stream:
        yaml.dump(document, stream)
