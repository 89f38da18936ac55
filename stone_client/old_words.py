"""Command and option words of release 0.1; each prints one line on stderr and runs the current command.

**Conventions.** `OLD_WORDS` is the only table. The first matching row of an old word applies. A row with a flag matches
if the flag is given, a row that needs an argument if an argument is given; any other row always matches.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from stone_client.streams import echo_notice

WITH_VALUE = frozenset({"--server", "--licence", "--reason", "--download", "--put", "--propose", "--leave-out"})
"""Options of the old commands that take a value."""
OLD_OPTIONS = {"--out": "--output", "--watch": "--wait"}
"""New names of old options; a command with an option of the old name keeps its meaning."""


@dataclass(frozen=True)
class OldWord:
    """A command of release 0.1 and the words that run it.

    `flag` is the old command's option that selects the act; `becomes` is the current option for its value (empty: the
    value is an argument, or the flag has none).
    """

    old: str
    new: str
    flag: str = ""
    becomes: str = ""
    needs_argument: bool = False

    def __str__(self) -> str:
        old = " ".join(("stone", self.old, *((self.flag,) if self.flag else ())))
        return f"{old} is now stone {self.new}"

    def fits(self, options: Sequence[str]) -> bool:
        """Return whether the row matches the old word with these options and arguments."""
        if self.flag:
            return any(option.partition("=")[0] == self.flag for option in options)
        return not self.needs_argument or any(_arguments(options))

    def renamed(self, options: Iterable[str]) -> list[str]:
        """Return the current command line."""
        kept = [word for option in options for word in self._option(option)]
        return [*self.new.split(), *kept]

    def _option(self, option: str) -> Iterator[str]:
        name, sign, value = option.partition("=")
        if not self.flag or name != self.flag:
            yield option
        else:
            yield from (word for word in (self.becomes, value if sign else "") if word)


OLD_WORDS = (
    OldWord("login", "auth login"),
    OldWord("status", "sequence status", needs_argument=True),
    OldWord("status", "sequence list"),
    *(
        OldWord(verb, f"sequence {verb}")
        for verb in ("upload", "register", "process", "watch", "download", "exports")
    ),
    OldWord("label-sets", "label-set"),
    OldWord("datasets", "dataset publish", flag="--create"),
    OldWord("datasets", "dataset download", flag="--download", becomes="--output"),
    OldWord("datasets", "dataset show", needs_argument=True),
    OldWord("datasets", "dataset list"),
    OldWord("statistics", "dataset statistics"),
    OldWord("splits", "dataset splits propose", flag="--propose"),
    OldWord("splits", "dataset splits put", flag="--put"),
    OldWord("splits", "dataset splits show"),
    OldWord("import", "dataset import"),
    OldWord("benchmarks", "benchmark list"),
    *(
        OldWord(verb, f"benchmark {verb}")
        for verb in (
            "manifest", "inputs", "submit", "results", "leaderboard", "compare", "withdraw", "reported",
        )
    ),
    OldWord("teams", "team"),
    *(OldWord(verb, f"model {verb}") for verb in ("train", "predict", "onnx")),
)  # fmt: skip


def words_of_today(words: Sequence[str]) -> tuple[list[str], str]:
    """Return the current command line, and a line about the change; the line is empty if nothing changed."""
    for row in OLD_WORDS:
        if row.old == words[0] and row.fits(words[1:]):
            return row.renamed(words[1:]), str(row)
    return list(words), ""


def words_like(word: str) -> list[str]:
    """Return the current commands of old words similar to this word."""
    near = get_close_matches(word, [row.old for row in OLD_WORDS])
    return list(dict.fromkeys(row.new for row in OLD_WORDS if row.old in near))


def with_new_options(words: list[str], known: Collection[str]) -> list[str]:
    """Return the words with the new names of old options, for a command with these options."""
    renamed = {old: new for old, new in OLD_OPTIONS.items() if new in known and old not in known}
    return [_renamed(word, renamed) for word in words] if renamed else words


def _renamed(word: str, renamed: Mapping[str, str]) -> str:
    name, sign, value = word.partition("=")
    if name not in renamed:
        return word
    echo_notice(f"{name} is now {renamed[name]}")
    return f"{renamed[name]}{sign}{value}"


def _arguments(options: Sequence[str]) -> Iterator[str]:
    """Yield the words that are neither options nor option values."""
    is_value = False
    for option in options:
        if not is_value and not option.startswith("-"):
            yield option
        is_value = option in WITH_VALUE
