"""Joins several recordings of one run: whose clock is off by how much, and which messages two of them hold.

    recordings → who has the LiDAR → shared messages, topics that go on → offsets measured by sensors → joined.json

**Conventions.** The reference is the recording with the LiDAR, of a run that was cut its first part; its clock is the
run's. An offset is added to a recording's times. What was asked for is taken, what can be measured is measured, and
nothing is guessed. Equal recordings give equal descriptions, in whatever order they are named.
"""

from contextlib import ExitStack
from dataclasses import replace

from services.ingest.joining.clocks import clock_offsets, members_of_run
from services.ingest.joining.request import JoinRequest, check_given, checked_paths, reference_first
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.joined.joined_store import check_types
from stone_recordings.joining.held_messages import held_by
from stone_recordings.joining.joined_recording import JoinedRecording


def join_recordings(asked: JoinRequest) -> JoinedRecording:
    """Raises: NotJoinedError (SYN-526), NoLidarError, JoinedTopicError (BAG-041), UnmeasuredOffsetError (SYN-523),
    ContradictoryOffsetsError (SYN-524), NoCommonTimeError (SYN-525), and what opening and decoding raise."""
    asked = replace(asked, paths=checked_paths(asked))
    with ExitStack() as opened:
        held = held_by({path.name: opened.enter_context(open_bag(path)) for path in asked.paths})
    check_types((topic.name, topic.type) for one in held for topic in one.topics)
    held = reference_first(held, asked.options.lidar_topic or asked.options.topics.get("lidar"))
    check_given(asked, held)
    members = members_of_run(held, clock_offsets(asked, held))
    return JoinedRecording(tuple(asked.path_of[member.name] for member in members), members)
