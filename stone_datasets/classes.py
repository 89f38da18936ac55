"""The traversability class of each label value: read from a class map, never guessed.

**Conventions.** A class map is a YAML or JSON object: `name` of the set, and `classes`: number → T, P, N, free or
unobserved. Without a map, the platform's values apply: 0 free, 1 T, 2 P, 3 N, and 255 unobserved.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from stone_datasets.faults import DatasetPlace, quoted
from stone_files.dataset_faults import DatasetFaultError

MEANINGS: Mapping[str, int] = {"free": 0, "T": 1, "P": 2, "N": 3, "unobserved": 255}
UNOBSERVED, UNKNOWN = 255, 254
MOST_MAP_BYTES = 64 * 1024


@dataclass(frozen=True, eq=False)
class ClassMap:
    """`meaning` (256,) uint8: class of each value, `UNOBSERVED`, or `UNKNOWN` for undefined values."""

    name: str
    meaning: NDArray[np.uint8]

    def with_unobserved(self, number: int | None) -> "ClassMap":
        """Return the map with `number` as unobserved, unless the map defines it or it is None."""
        if number is None or self.meaning[number] != UNKNOWN:
            return self
        meaning = self.meaning.copy()
        meaning[number] = UNOBSERVED
        return ClassMap(self.name, meaning)


def class_map_of(name: str, meanings: Mapping[int, str]) -> ClassMap:
    table = np.full(256, UNKNOWN, np.uint8)
    for number, meaning in meanings.items():
        table[number] = MEANINGS[meaning]
    return ClassMap(name, table)


OWN_CLASSES = class_map_of("stone", {0: "free", 1: "T", 2: "P", 3: "N", 255: "unobserved"})


def read_class_map(path: Path) -> ClassMap:
    """Return the map in a file. Raises `DST-070`."""
    position = DatasetPlace(path.name)
    with path.open("rb") as file:
        content = file.read(MOST_MAP_BYTES + 1)
    if len(content) > MOST_MAP_BYTES:
        raise DatasetFaultError("DST-070", position, f"it has more than {MOST_MAP_BYTES} bytes")
    try:
        record = YAML(typ="safe", pure=True).load(content.decode("utf-8"))
    except (YAMLError, ValueError, RecursionError, TypeError, AttributeError) as error:
        raise DatasetFaultError("DST-070", position, "it is not YAML") from error
    if (
        not isinstance(record, dict)
        or not isinstance(record.get("name"), str)
        or not isinstance(record.get("classes"), dict)
    ):
        raise DatasetFaultError("DST-070", position, "it has no name, or no classes")
    return class_map_of(record["name"][:100], dict(_meant(position, *item) for item in record["classes"].items()))


def _meant(position: DatasetPlace, number: object, meaning: object) -> tuple[int, str]:
    if isinstance(number, str) and number.isdecimal() and len(number) < 4:  # JSON keys are text
        number = int(number)
    if type(number) is not int or not 0 <= number < 256:
        raise DatasetFaultError("DST-070", position, f"{quoted(number)} is not a number from 0 to 255")
    if not isinstance(meaning, str) or meaning not in MEANINGS:
        raise DatasetFaultError(
            "DST-070", position, f"{number} is {quoted(meaning)}; expected one of {', '.join(MEANINGS)}"
        )
    return number, meaning
