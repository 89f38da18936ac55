"""The offset of every recording's clock: given, told by what recordings share, or measured by their sensors.

**Conventions.** Recordings that share messages or go on with each other's topics are a group of one clock: what is
known of one is known of all. `held[0]` is the reference.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager

from services.ingest.joining.measurement import measured_offset, reference_of
from services.ingest.joining.pose_recordings import bears_gps_time, best_poses, has_poses, pose_offset
from services.ingest.joining.request import JoinRequest
from stone_files.joined_file import GIVEN, REFERENCE, SWEEPS, JoinedMember
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.private_folder import PrivateFolder
from stone_recordings.joining.clock_links import ClockOffset, linked
from stone_recordings.joining.errors import NoCommonTimeError, UnmeasuredOffsetError
from stone_recordings.joining.held_messages import HeldMessages
from stone_recordings.joining.joined_recording import JoinedRecording, write_joined
from stone_recordings.joining.overlaps import left_out

Held = Sequence[HeldMessages]


def clock_offsets(asked: JoinRequest, held: Held) -> tuple[ClockOffset, ...]:
    """In the order of `held`.

    Raises: UnmeasuredOffsetError, ContradictoryOffsetsError, NoCommonTimeError, and what synchronising raises.
    """
    known = _known(asked, held)
    if len(known) < len(held):
        known |= _measured(asked, held, known)
    _check_common_time(held, known)
    return tuple(known[number] for number in range(len(held)))


def members_of_run(held: Held, offsets: Sequence[ClockOffset]) -> tuple[JoinedMember, ...]:
    """What `joined.json` says of recordings with these offsets."""
    return tuple(
        JoinedMember(one.name, to.offset_ns, to.sigma_ns, to.known_by, to.kept_topics, left)
        for one, to, left in zip(held, offsets, left_out(held, offsets), strict=True)
    )


def _known(asked: JoinRequest, held: Held) -> dict[int, ClockOffset]:
    """Of the recordings that messages or topics lead to from the reference, or from one whose offset is given."""
    known = dict(linked(held, 0)) | {0: ClockOffset(0, None, (REFERENCE,))}
    for number, one in enumerate(held[1:], start=1):
        if one.name in asked.given_ns:
            known[number] = ClockOffset(asked.given_ns[one.name], None, (GIVEN,))
            for other, link in linked(held, number).items():
                known.setdefault(other, link.after(known[number]))
    return known


def _measured(asked: JoinRequest, held: Held, known: Mapping[int, ClockOffset]) -> Mapping[int, ClockOffset]:
    """Of the others, those of one clock together."""
    waiting = [number for number in range(len(held)) if number not in known]
    if asked.calibration is None:
        names = [held[number].name for number in waiting]
        raise UnmeasuredOffsetError(names, ["no calibration says where its sensors sit"])
    posed = {} if has_poses((held[number] for number in known), asked.options) else _with_poses(asked, held, known)
    found = {number: offset for number, offset in posed.items() if SWEEPS in offset.known_by}
    with _on_one_clock(asked, held, {**posed, **known}) as run:
        reference = reference_of(run, asked.calibration, asked.options)
        for number in waiting:
            if number not in found:
                group = linked(held, number)
                with _on_one_clock(asked, held, group) as bag:
                    offset = measured_offset(bag, held[number].name, reference)
                found |= {other: link.after(offset) for other, link in group.items()}
    return found


def _with_poses(asked: JoinRequest, held: Held, known: Mapping[int, ClockOffset]) -> dict[int, ClockOffset]:
    """The recording with the poses and those of its clock: measured by the sweeps, or by GPS time, which needs no
    offset; {} where none has poses."""
    others = [held[number] for number in range(len(held)) if number not in known]
    posed = best_poses(others)
    if posed is None or asked.calibration is None:
        return {}
    group = linked(held, next(number for number, one in enumerate(held) if one is posed))
    if bears_gps_time(posed):
        return {number: link.after(ClockOffset(0, None, ())) for number, link in group.items()}

    def open_at(offset: ClockOffset) -> AbstractContextManager[Bag]:
        moved = {number: link.after(offset) for number, link in group.items()}
        return _on_one_clock(asked, held, {**moved, **known})

    offset = pose_offset(posed.name, open_at, asked.calibration, asked.options)
    return {number: link.after(offset) for number, link in group.items()}


@contextmanager
def _on_one_clock(asked: JoinRequest, held: Held, offsets: Mapping[int, ClockOffset]) -> Iterator[Bag]:
    """Some of the recordings, open as one."""
    numbers = sorted(offsets)
    if len(numbers) == 1:
        with open_bag(asked.path_of[held[numbers[0]].name]) as bag:
            yield bag
        return
    members = members_of_run([held[number] for number in numbers], [offsets[number] for number in numbers])
    folder = PrivateFolder()
    try:
        write_joined(JoinedRecording(tuple(asked.path_of[member.name] for member in members), members), folder.path)
        with open_bag(folder.path) as bag:
            yield bag
    finally:
        folder.close()


def _check_common_time(held: Held, offsets: Mapping[int, ClockOffset]) -> None:
    """Raises: NoCommonTimeError for what lies wholly outside the run."""
    run = set(linked(held, 0))
    first_ns, last_ns = min(held[number].start_ns for number in run), max(held[number].end_ns for number in run)
    for number in sorted(set(offsets) - run):
        group = linked(held, number)
        start_ns = min(held[other].start_ns + offsets[other].offset_ns for other in group)
        end_ns = max(held[other].end_ns + offsets[other].offset_ns for other in group)
        apart_ns = max(start_ns - last_ns, 0) or min(end_ns - first_ns, 0)
        if apart_ns:
            raise NoCommonTimeError(held[number].name, apart_ns / 1e9, held[0].name)
