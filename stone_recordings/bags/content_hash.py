"""The content hash of a recording in place: its index, and the start of every message except pictures.

**Conventions.** Pictures are most of a recording's bytes, and labels need none of them. The hash is the same for any
container, and costs pages of a file, not the file.
"""

from hashlib import sha256

from stone_recordings.bags.bag import Bag

PICTURES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
HASHED_BYTES = 256


def content_sha256(bag: Bag) -> str:
    """Return the sha256 of names, types, log times and, except for pictures, the first bytes of all messages."""
    whole = sha256()
    read = sorted(topic.name for topic in bag.topics if topic.encoding == "cdr" and topic.type not in PICTURES)
    by_topic = {name: sha256() for name in read}
    for name, index, payload in bag.heads(read):
        by_topic[name].update(index.to_bytes(8, "little") + payload[:HASHED_BYTES])
    for topic in sorted(bag.topics, key=lambda topic: topic.name):
        whole.update(f"{topic.name}\n{topic.type}\n{topic.count}\n".encode())
        whole.update(bag.log_times_ns(topic.name).tobytes())
        if topic.name in by_topic:
            whole.update(by_topic[topic.name].digest())
    return whole.hexdigest()
