"""`stone check`: check that a published dataset is complete and well-formed, and show its contents."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from stone_client.options import DatasetClassesOption, DatasetGridOption, DatasetLayoutOption
from stone_client.progress import reported
from stone_client.refusals import REFUSED
from stone_client.streams import JsonOption, echo_json, echo_notice
from stone_local.dataset_tables import show_contents

if TYPE_CHECKING:
    from stone_datasets.reading import DatasetCheck
    from stone_files.byte_ranges import ByteRanges

DatasetArgument = Annotated[
    str,
    typer.Argument(
        metavar="DATASET",
        help="A folder, tar or ZIP in nuScenes or Occ3D layout, or the https URL of a ZIP.",
    ),
]
FaultsOption = Annotated[int, typer.Option("--faults", min=1, max=100_000, help="Maximum number of listed faults.")]


def check(
    dataset: DatasetArgument,
    classes: DatasetClassesOption = None,
    layout: DatasetLayoutOption = None,
    grid: DatasetGridOption = None,
    faults: FaultsOption = 100,
    as_json: JsonOption = False,
) -> None:
    """Check a published dataset completely and show its contents, or its faults by table, row and file.

    It reads every row of the tables, every sweep, scan and label file, and the beginning and end of every image. A ZIP
    is read in place, without unpacking. Exit code 1 if there is any fault.
    """
    from stone_datasets.classes import OWN_CLASSES, read_class_map
    from stone_datasets.reading import check_dataset
    from stone_datasets.stated_layout import StatedLayout
    from stone_files.grid_file import chosen_grid

    where, stated = _opened(dataset), StatedLayout(layout, None if grid is None else chosen_grid(grid))
    class_map = OWN_CLASSES if classes is None else read_class_map(classes)
    with reported() as progress:
        result = check_dataset(where, class_map, faults, lambda done, of: progress("frames", done, of), stated)
    if result.contents is None:
        _refuse(result, as_json=as_json)
    record = result.contents.as_record()
    if as_json:
        echo_json(record)
    else:
        show_contents(record)


def _opened(dataset: str) -> "Path | ByteRanges":
    """Return the path, or the byte ranges of a URL."""
    from stone_local.url_ranges import is_url, open_url

    if is_url(dataset):
        return open_url(dataset)
    path = Path(dataset)
    if not path.exists():
        raise typer.BadParameter(f"{dataset!r} does not exist", param_hint="DATASET")
    return path


def _refuse(result: "DatasetCheck", *, as_json: bool) -> NoReturn:
    """Print every fault on its own line, then how far the check came."""
    for fault in result.faults.found:
        echo_notice(f"{fault.code}: {fault}")
    if result.faults.left_out:
        echo_notice(f"… and {result.faults.left_out} more")
    if result.reached not in ("files", "sweeps"):
        echo_notice(
            f"These faults are from its {result.reached}; later parts were not checked. Fix them and check again"
        )
    if as_json:
        faults = [fault.as_record() for fault in result.faults.found]
        echo_json({"faults": faults, "faults_total": result.faults.total, "reached": result.reached})
    raise typer.Exit(REFUSED)
