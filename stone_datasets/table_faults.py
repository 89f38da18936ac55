"""What is refused of how the tables of a dataset fit together: references, chains, stamps, files, splits."""

from typing import ClassVar

from stone_datasets.faults import DatasetFaultError


class DanglingReferenceError(DatasetFaultError):
    """A row names a token that the other table does not have."""

    code: ClassVar[str] = "DST-030"
    likely: ClassVar[str] = "were rows left out when the dataset was cut?"


class DuplicateSceneError(DatasetFaultError):
    """Two scenes have one name."""

    code: ClassVar[str] = "DST-031"
    likely: ClassVar[str] = "their labels would lie in one folder"


class SceneEndsError(DatasetFaultError):
    """A scene's first or last sample is another than its samples say."""

    code: ClassVar[str] = "DST-032"
    likely: ClassVar[str] = "was the scene cut without writing its row anew?"


class SampleCountError(DatasetFaultError):
    """A scene's nbr_samples is not the number of its samples."""

    code: ClassVar[str] = "DST-033"
    likely: ClassVar[str] = "was the scene cut without writing its row anew?"


class ChainError(DatasetFaultError):
    """prev and next do not lead through all rows once."""

    code: ClassVar[str] = "DST-034"
    likely: ClassVar[str] = "was a row left out, or put in, without linking its neighbours?"


class StampOrderError(DatasetFaultError):
    """Stamps do not increase along next."""

    code: ClassVar[str] = "DST-035"
    likely: ClassVar[str] = "did the clock jump, or are rows linked in another order?"


class NoSweepError(DatasetFaultError):
    """A frame has no LIDAR_TOP, whose pose is the frame's."""

    code: ClassVar[str] = "DST-036"
    likely: ClassVar[str] = "is the sweep not a key frame?"


class ChannelTwiceError(DatasetFaultError):
    """A frame has two key-frame data of one sensor."""

    code: ClassVar[str] = "DST-037"
    likely: ClassVar[str] = "is a sweep between key frames marked as one?"


class CalibrationChangesError(DatasetFaultError):
    """A sensor has two calibrations within one scene."""

    code: ClassVar[str] = "DST-038"
    likely: ClassVar[str] = "a sequence has one calibration: cut the scene in two"


class DatumFarError(DatasetFaultError):
    """A datum is more than a second from its frame."""

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
    """The splits are no object of lists of scene names."""

    code: ClassVar[str] = "DST-045"
    likely: ClassVar[str] = 'expected is {"train": ["scene", …], …}, and one such file'


class UnknownSplitSceneError(DatasetFaultError):
    """A split names a scene that is not there."""

    code: ClassVar[str] = "DST-046"
    likely: ClassVar[str] = "are the splits of a larger dataset?"


class SceneInTwoSplitsError(DatasetFaultError):
    """A scene is in two splits."""

    code: ClassVar[str] = "DST-047"
    likely: ClassVar[str] = "who trains on it would be tested on it"


class TablesGrowError(DatasetFaultError):
    """Rows that belong to several scenes, written for each, would become many times what the tables are."""

    code: ClassVar[str] = "DST-048"
    likely: ClassVar[str] = "are rows of log, map, category or sensor many or long, and every scene's?"


class PosesOffLatticeError(DatasetFaultError):
    """A scene lies farther from the origin of `global` than a map of voxels reaches."""

    code: ClassVar[str] = "DST-049"
    likely: ClassVar[str] = "are poses in UTM or ECEF? subtract the same whole metres from the translations of all"
