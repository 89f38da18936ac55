"""Meanings of BAG codes: files, folders and databases that hold recordings."""

from stone_base.codes.meaning import CodeMeaning

MEANINGS = (
    CodeMeaning(
        "BAG-001",
        "refused",
        "The file is not a recording: its first bytes belong to another kind of file.",
        "Download the recording again. Often a saved web page or a Git LFS pointer was uploaded instead.",
    ),
    CodeMeaning(
        "BAG-010",
        "less",
        "The file was not closed properly and ends early. Complete messages before the end can be read or recovered.",
        "`stone recover RUN -o whole.mcap` keeps every complete message and lists the losses. If the original "
        "is complete, copy the recording again.",
        as_error="refused",
    ),
    CodeMeaning(
        "BAG-011",
        "none",
        "The file has no usable index, so the whole file was read once to find its messages.",
        "No action is needed. The file opens faster if the recorder is closed properly and fastwrite is off.",
    ),
    CodeMeaning(
        "BAG-012",
        "less",
        "A length, an offset or a value contradicts the rest of the file, or one topic is described in two "
        "ways. The affected data is left out; if nothing else can be read, the recording is refused.",
        "If the original is intact, copy the recording again; otherwise use `stone recover`.",
    ),
    CodeMeaning(
        "BAG-013",
        "refused",
        "A chunk declares an implausibly large size.",
        "Record with chunks of a few MiB. If the chunks were recorded at that size, copy the recording again.",
    ),
    CodeMeaning(
        "BAG-014",
        "less",
        "A topic without CDR encoding is left out. A recording without any CDR topic is refused.",
        "Record with the default serialisation of ROS 2, or convert protobuf and JSON recordings.",
    ),
    CodeMeaning(
        "BAG-015", "refused", "The recording has no topic of that name.", "Choose a topic that `stone inspect` lists."
    ),
    CodeMeaning(
        "BAG-016",
        "less",
        "The checksum of a chunk is wrong. Its messages are left out; messages of other chunks are used.",
        "If the original is intact, copy the recording again.",
    ),
    CodeMeaning(
        "BAG-017",
        "refused",
        "The chunks use a compression algorithm that their format does not define.",
        "Convert the recording to zstd or lz4 chunks.",
    ),
    CodeMeaning(
        "BAG-018",
        "refused",
        "The .db3 file is not a rosbag2 database, or none of its content can be read.",
        "Copy the file again, together with its -wal file.",
    ),
    CodeMeaning(
        "BAG-019",
        "refused",
        "The folder does not identify its recording files, or none of them exists.",
        "Select the file itself, or copy the folder again with its metadata.yaml.",
    ),
    CodeMeaning(
        "BAG-020",
        "less",
        "The definition of a message type is unknown, so its topic is not read.",
        "Record in MCAP, which contains the definitions, or put the .msg files next to the bag.",
    ),
    CodeMeaning("BAG-021", "less", "Files that metadata.yaml lists are missing or empty.", "Copy them from the robot."),
    CodeMeaning(
        "BAG-023",
        "none",
        "metadata.yaml cannot be read; the files next to it are read without it.",
        "Ignore this if all files belong to this run.",
    ),
    CodeMeaning(
        "BAG-024",
        "less",
        "Files that metadata.yaml does not list are left out.",
        "Ignore this if the files belong to another run; otherwise correct metadata.yaml (`ros2 bag reindex`).",
    ),
    CodeMeaning(
        "BAG-025",
        "none",
        "The folder has no metadata.yaml; its files are read as one recording.",
        "Ignore this if all files belong to this run.",
    ),
    CodeMeaning("BAG-026", "refused", "The output of a recovery is its own input file.", "Choose another output file."),
    CodeMeaning(
        "BAG-027",
        "refused",
        "Compressed data expands to an implausibly large size.",
        "Copy the recording again: it is damaged or hostile. If it is intact, decompress it on another machine.",
    ),
    CodeMeaning(
        "BAG-028",
        "refused",
        "The disk for temporary files has no room for decompressed or copied data.",
        "Free space on this disk or set TMPDIR to a larger one, and try again.",
    ),
    CodeMeaning(
        "BAG-029",
        "none",
        "The database was not closed; the content of its -wal or -journal file is applied.",
        "No action is needed. Next time, stop the recorder before you copy the file.",
    ),
    CodeMeaning(
        "BAG-030",
        "less",
        "The database is damaged; only the messages in its readable pages are used.",
        "If the original is intact, copy the file again.",
    ),
    CodeMeaning(
        "BAG-031",
        "less",
        "Some database rows are not messages and are left out.",
        "Ignore a few rows; if there are many, copy the file again.",
    ),
    CodeMeaning(
        "BAG-032",
        "none",
        "Extra bytes follow the end of the file; the recording itself is complete.",
        "No action is needed.",
    ),
    CodeMeaning(
        "BAG-033",
        "less",
        "The beginning of the file is damaged; the messages in the summary at its end are read.",
        "`stone recover` writes a file that other programs can open.",
    ),
    CodeMeaning(
        "BAG-036",
        "refused",
        "The messages of the ROS 1 bag are encrypted.",
        "Run `rosbag decrypt` on a machine with ROS 1 and the key.",
    ),
    CodeMeaning(
        "BAG-040", "refused", "The description file of a joined recording is invalid.", "Join the recordings again."
    ),
    CodeMeaning(
        "BAG-041",
        "refused",
        "A topic has different types in the recordings to be joined.",
        "Leave out the recording that the message names, or rename the topic when you record.",
    ),
    CodeMeaning(
        "BAG-042",
        "refused",
        "The file has no index, so it cannot be read in place by ranges.",
        "Rewrite the file with `stone recover`, or upload it.",
    ),
)
