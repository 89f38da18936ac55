"""One bag written as several files, as a recorder splits it; by the mcap library."""

from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer


def split_into(bag: Path, folder: Path, parts: int) -> None:
    """Write the messages of `bag` into `parts` files, a share of its time each, with the mcap library."""
    with bag.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        first, last = summary.statistics.message_start_time, summary.statistics.message_end_time
        for part in range(parts):
            begin, end = (first + (last + 1 - first) * edge // parts for edge in (part, part + 1))
            with (folder / f"run_{part}.mcap").open("wb") as out:
                writer = Writer(out)
                writer.start(profile="ros2")
                schemas = {s.id: writer.register_schema(s.name, s.encoding, s.data) for s in summary.schemas.values()}
                channels = {
                    c.id: writer.register_channel(c.topic, c.message_encoding, schemas[c.schema_id], dict(c.metadata))
                    for c in summary.channels.values()
                }
                for _schema, channel, message in reader.iter_messages(starting_at=begin, ending_before=end):
                    stamps = (message.log_time, message.publish_time)
                    writer.add_message(channels[channel.id], stamps[0], message.data, stamps[1], message.sequence)
                writer.finish()  # type: ignore[no-untyped-call]
