"""What is refused of how the tables of a dataset fit together: references, chains, stamps, files, splits."""

from typing import ClassVar

from stone_datasets.faults import DatasetFaultError


class DanglingReferenceError(DatasetFaultError):
    """A row names a token that the other table does not have."""

    code: ClassVar[str] = "DST-030"
    likely: ClassVar[str] = "were rows left out when the dataset was cut?"


class DuplicateSceneError(DatasetFaultError):
    """Two scenes have the same name."""

    code: ClassVar[str] = "DST-031"
    likely: ClassVar[str] = "their labels would be in the same folder"


class SceneEndsError(DatasetFaultError):
    """A scene's first or last sample is another than its samples say."""

    code: ClassVar[str] = "DST-032"
    likely: ClassVar[str] = "was the scene shortened without updating its row?"


class SampleCountError(DatasetFaultError):
    """A scene's nbr_samples is not the number of its samples."""

    code: ClassVar[str] = "DST-033"
    likely: ClassVar[str] = "was the scene shortened without updating its row?"


class ChainError(DatasetFaultError):
    """prev and next do not lead through all rows once."""

    code: ClassVar[str] = "DST-034"
    likely: ClassVar[str] = "was a row left out, or put in, without linking its neighbours?"


class StampOrderError(DatasetFaultError):
    """Stamps do not increase along next."""

    code: ClassVar[str] = "DST-035"
    likely: ClassVar[str] = "did the clock jump, or are rows linked in another order?"


class NoSweepError(DatasetFaultError):
    """A frame has no LIDAR_TOP sweep, whose pose is the frame's pose."""

    code: ClassVar[str] = "DST-036"
    likely: ClassVar[str] = "is the sweep not a key frame?"


class ChannelTwiceError(DatasetFaultError):
    """A frame has two key-frame rows of one sensor."""

    code: ClassVar[str] = "DST-037"
    likely: ClassVar[str] = "is a sweep between key frames marked as one?"


class CalibrationChangesError(DatasetFaultError):
    """A sensor has two calibrations within one scene."""

    code: ClassVar[str] = "DST-038"
    likely: ClassVar[str] = "a sequence has one calibration: cut the scene in two"


class DatumFarError(DatasetFaultError):
    """A row of sample_data is more than a second from its frame."""

    code: ClassVar[str] = "DST-039"
    likely: ClassVar[str] = "does it belong to another frame?"


class FileStampError(DatasetFaultError):
    """A file's name has another stamp than its row."""

    code: ClassVar[str] = "DST-040"
    likely: ClassVar[str] = "does the row name the file of another frame?"


class FileChannelError(DatasetFaultError):
    """A file's name or folder is of another sensor than its row."""

    code: ClassVar[str] = "DST-041"
    likely: ClassVar[str] = "does the row name the file of another camera?"


class FileTwiceError(DatasetFaultError):
    """Two rows name one file."""

    code: ClassVar[str] = "DST-042"
    likely: ClassVar[str] = "was a row copied without changing its file name?"


class BadSplitsError(DatasetFaultError):
    """The splits are not an object of lists of scene names."""

    code: ClassVar[str] = "DST-045"
    likely: ClassVar[str] = 'expected is {"train": ["scene", …], …}, and one such file'


class UnknownSplitSceneError(DatasetFaultError):
    """A split names a scene that does not exist."""

    code: ClassVar[str] = "DST-046"
    likely: ClassVar[str] = "are the splits of a larger dataset?"


class SceneInTwoSplitsError(DatasetFaultError):
    """A scene is in two splits."""

    code: ClassVar[str] = "DST-047"
    likely: ClassVar[str] = "a method trained on it would be tested on it"


class TablesGrowError(DatasetFaultError):
    """Rows that belong to several scenes, copied to each, would take many times the size of the tables."""

    code: ClassVar[str] = "DST-048"
    likely: ClassVar[str] = "are there many or long rows of log, map, category or sensor that belong to every scene?"


class PosesOffLatticeError(DatasetFaultError):
    """A scene lies farther from the origin of `global` than a map of voxels reaches."""

    code: ClassVar[str] = "DST-049"
    likely: ClassVar[str] = "are poses in UTM or ECEF? subtract the same whole metres from the translations of all"
