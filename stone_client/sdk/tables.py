"""Lists of records that print as a table and become a pandas DataFrame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from html import escape
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeVar, overload

if TYPE_CHECKING:
    from pandas import DataFrame

MOST_SHOWN = 20


class Record(Protocol):
    """A frozen dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


R = TypeVar("R", bound=Record)


class Table(Sequence[R], Generic[R]):
    """Records of one kind, in the order of the server. It is a sequence; notebooks show it as a table."""

    def __init__(self, kind: type[R], records: Iterable[R]) -> None:
        self._kind, self._records = kind, tuple(records)

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the fields of a record."""
        return tuple(field.name for field in fields(self._kind) if field.repr)

    def rows(self) -> list[dict[str, Any]]:
        """Return the values of each record by column; a nested column, such as `ratios`, is expanded."""
        return [_spread({name: getattr(record, name) for name in self.columns}) for record in self._records]

    def to_pandas(self) -> DataFrame:
        """Return a DataFrame with a row for each record. Requires pandas, which the client does not install."""
        from pandas import DataFrame

        return DataFrame(self.rows(), columns=None if self._records else list(self.columns))

    @overload
    def __getitem__(self, index: int) -> R: ...
    @overload
    def __getitem__(self, index: slice) -> Table[R]: ...
    def __getitem__(self, index: int | slice) -> R | Table[R]:
        if isinstance(index, slice):
            return Table(self._kind, self._records[index])
        return self._records[index]

    def __len__(self) -> int:
        return len(self._records)

    def __repr__(self) -> str:
        shown = [f"  {record!r}" for record in self._records[:MOST_SHOWN]]
        more = len(self) - len(shown)
        return "\n".join([f"<{len(self)} × {self._kind.__name__}>", *shown, *([f"  … {more} more"] if more else [])])

    def _repr_html_(self) -> str:
        rows = self[:MOST_SHOWN].rows()
        names = list(rows[0]) if rows else list(self.columns)
        head = "".join(f"<th>{escape(name)}</th>" for name in names)
        body = "".join(f"<tr>{''.join(f'<td>{escape(_cell(row[name]))}</td>' for name in names)}</tr>" for row in rows)
        more = len(self) - len(rows)
        foot = f"<p>{more} more</p>" if more else ""
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{foot}"


def _spread(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the row with the values of a mapping as separate columns."""
    spread = dict[str, Any]()
    for name, value in row.items():
        spread |= value if isinstance(value, Mapping) else {name: value}
    return spread


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.4f}" if isinstance(value, float) else str(value)
