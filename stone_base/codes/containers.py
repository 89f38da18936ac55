"""Meanings of BAG codes: files, folders and databases that hold recordings."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "BAG-001",
        "refused",
        "The file is not a recording: its first bytes belong to another kind of file.",
        "Fetch the recording again; a saved web page or a Git LFS pointer is often what was uploaded.",
    ),
    CodeMeaning(
        "BAG-010",
        "less",
        "The file ends before it was closed. What is whole up to the cut can be read or recovered.",
        "stone recover RUN -o whole.mcap keeps every whole message and says what is lost; copy the recording "
        "again where the original is whole.",
        as_error="refused",
    ),
    CodeMeaning(
        "BAG-011",
        "none",
        "The file has no usable index, so all of it was read once to find its messages.",
        "Nothing. Close the recorder properly, or record without fastwrite, and it opens faster.",
    ),
    CodeMeaning(
        "BAG-012",
        "less",
        "A length, an offset or a value in the file contradicts the rest, or one topic is described in two "
        "ways. What it concerns is left out; where nothing else can be read, the recording is refused.",
        "Copy the recording again where the original is sound, or use stone recover.",
    ),
    CodeMeaning(
        "BAG-013",
        "refused",
        "A chunk declares more bytes than a recorder puts into one.",
        "Record with chunks of a few MiB; copy the recording again if it was recorded so.",
    ),
    CodeMeaning(
        "BAG-014",
        "less",
        "A topic is not encoded as CDR and is left out; a recording without any CDR topic is refused.",
        "Record with the default serialisation of ROS 2, or convert protobuf and JSON recordings.",
    ),
    CodeMeaning(
        "BAG-015", "refused", "The recording has no topic of that name.", "Choose one that stone inspect lists."
    ),
    CodeMeaning(
        "BAG-016",
        "less",
        "The checksum of a chunk is wrong; its messages are left out, and those of other chunks are used.",
        "Copy the recording again where the original is sound.",
    ),
    CodeMeaning(
        "BAG-017",
        "refused",
        "Chunks are compressed by an algorithm that their format does not have.",
        "Convert the recording to zstd or lz4 chunks.",
    ),
    CodeMeaning(
        "BAG-018",
        "refused",
        "The .db3 file is not a rosbag2 database, or nothing in it can be read.",
        "Copy it again, together with its -wal file.",
    ),
    CodeMeaning(
        "BAG-019",
        "refused",
        "The folder does not say which of its files are the recording, or none of them is there.",
        "Name the file itself, or copy the folder again with its metadata.yaml.",
    ),
    CodeMeaning(
        "BAG-020",
        "less",
        "No definition of a message type is known, so its topic is not read.",
        "Record in MCAP, which contains the definitions, or put the .msg files beside the bag.",
    ),
    CodeMeaning("BAG-021", "less", "Files that metadata.yaml lists are missing or empty.", "Copy them from the robot."),
    CodeMeaning(
        "BAG-023",
        "none",
        "metadata.yaml cannot be read; the files beside it are read without it.",
        "Nothing, if all of them are of this run.",
    ),
    CodeMeaning(
        "BAG-024",
        "less",
        "Files that metadata.yaml does not list are left out.",
        "Nothing, if they are of another run; otherwise correct metadata.yaml (ros2 bag reindex).",
    ),
    CodeMeaning(
        "BAG-025",
        "none",
        "There is no metadata.yaml; the files of the folder are read as one recording.",
        "Nothing, if all of them are of this run.",
    ),
    CodeMeaning(
        "BAG-026", "refused", "A recovery was asked to write over the file that it reads.", "Name another output."
    ),
    CodeMeaning(
        "BAG-027",
        "refused",
        "Compressed data expands beyond anything that a recorder packs.",
        "Copy the recording again: it is damaged or hostile. Decompress it elsewhere if it is sound.",
    ),
    CodeMeaning(
        "BAG-028",
        "refused",
        "The disk for temporary files has no room for what must be decompressed or copied.",
        "Make room there, or set TMPDIR to a larger disk, and try again.",
    ),
    CodeMeaning(
        "BAG-029",
        "none",
        "The database was not closed; what its -wal or -journal file holds is applied.",
        "Nothing. Stop the recorder before copying next time.",
    ),
    CodeMeaning(
        "BAG-030",
        "less",
        "The database is damaged; the messages that its pages still hold were read.",
        "Copy it again where the original is sound.",
    ),
    CodeMeaning(
        "BAG-031",
        "less",
        "Some rows of the database are not messages and are left out.",
        "Nothing for a few; copy the file again where there are many.",
    ),
    CodeMeaning("BAG-032", "none", "Bytes follow the end of the file; the recording itself is whole.", "Nothing."),
    CodeMeaning(
        "BAG-033",
        "less",
        "The beginning of the file is damaged; what the summary at its end lists is read.",
        "stone recover writes a file that other programs open.",
    ),
    CodeMeaning(
        "BAG-036",
        "refused",
        "The messages of the ROS 1 bag are encrypted.",
        "Run rosbag decrypt where ROS 1 and the key are.",
    ),
    CodeMeaning(
        "BAG-040", "refused", "The file that describes a joined recording is not valid.", "Join the recordings again."
    ),
    CodeMeaning(
        "BAG-041",
        "refused",
        "A topic has two types in the recordings that are to be joined.",
        "Leave out the recording that the sentence names, or rename the topic when recording.",
    ),
    CodeMeaning(
        "BAG-042",
        "refused",
        "The file has no index, so it cannot be read by ranges where it lies.",
        "Write it anew by stone recover, or upload it.",
    ),
)
