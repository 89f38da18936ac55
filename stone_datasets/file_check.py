"""Every file of a dataset read and checked: samples of all sensors, labels of all frames."""

from collections.abc import Callable

from stone_datasets.classes import ClassMap
from stone_datasets.contents import DatasetContents
from stone_datasets.faults import DatasetFaultError, DatasetFaults, DatasetPlace
from stone_datasets.file_faults import LabelsMissingError, SampleMissingError
from stone_datasets.index import DatasetChannel, DatasetIndex, DatasetSequence
from stone_datasets.labels import read_labels
from stone_datasets.samples import check_sample
from stone_files.dataset_layout import ANNOTATIONS

Progress = Callable[[int, int], None]


def check_files(index: DatasetIndex, classes: ClassMap, faults: DatasetFaults, progress: Progress) -> DatasetContents:
    """What the files hold; `progress` is told frames done and all."""
    contents, total, done = DatasetContents(index, classes.name), sum(map(len, index.sequences)), 0
    for sequence in index.sequences:
        for channel in sequence.channels.values():
            _check_channel(channel, contents, faults)
        for frame in range(len(sequence) if sequence.is_labelled else 0):
            _check_labels((sequence, frame), classes, contents, faults)
            progress(done + frame, total)
        done += len(sequence)
        progress(done, total)
    return contents


def _check_channel(channel: DatasetChannel, contents: DatasetContents, faults: DatasetFaults) -> None:
    index = contents.index
    for place, row in enumerate(channel.rows.tolist()):
        at = _place(index, channel, row)
        try:
            span = index.file(channel, place)
            if span is None:
                raise SampleMissingError(at, f"{channel.filename(place)} is missing")
            check_sample(span, channel.sensor, at)
        except DatasetFaultError as fault:
            faults.add(fault)
            continue
        contents.files_of[channel.sensor.channel] += 1
        contents.size_bytes += span.size_bytes


def _place(index: DatasetIndex, channel: DatasetChannel, row: int) -> DatasetPlace:
    if index.layout == "release":
        return DatasetPlace(f"{index.files.version}/sample_data.json", row + 1)
    return DatasetPlace(ANNOTATIONS)


def _check_labels(
    of: tuple[DatasetSequence, int], classes: ClassMap, contents: DatasetContents, faults: DatasetFaults
) -> None:
    sequence, frame = of
    try:
        span = contents.index.labels(sequence, frame)
        if span is None:
            raise LabelsMissingError(DatasetPlace(sequence.label_name(frame)), "it is missing")
        contents.add_labels(read_labels(span, classes))
    except DatasetFaultError as fault:
        faults.add(fault)
        return
    contents.size_bytes += span.size_bytes
