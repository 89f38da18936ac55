"""The root of every error the platform raises on purpose, and `Refused`, which most code raises.

**Conventions.** A refusal is `Refused(code, sentence)`; the sentence quotes value, limit and likely mistake. A class
exists only if somebody catches it or reads its attributes. In docstrings, "Raises `upload_locked`" names the code.
Nothing is raised as a bare `StoneError`.
"""


def one_line(text: str) -> str:
    """`text` with what is not printable escaped: what it quotes may hold line ends and commands to a terminal."""
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in text)


class StoneError(Exception):
    """An input or a state is refused; `code` names the reason for programs, the sentence for people."""

    code: str

    def __init__(self, sentence: str) -> None:
        super().__init__(one_line(sentence))

    def __reduce__(self) -> tuple[object, ...]:
        """Some classes take facts, not sentences, so a pickle carries the finished sentence (worker → parent)."""
        return _restored, (type(self), self.args, self.__dict__)


def _restored(leaf: type[StoneError], args: tuple[object, ...], facts: dict[str, object]) -> StoneError:
    error = leaf.__new__(leaf)
    error.args = args
    error.__dict__.update(facts)
    return error


class Refused(StoneError):  # noqa: N818
    """A refusal that is known by its code alone."""

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


def splits_forbidden() -> Refused:
    return Refused(
        "splits_forbidden",
        "only administrators may set the draft splits; import without --set-splits (sets_splits), or sign in "
        "with `stone auth login URL --name ADMINISTRATOR --admin`",
    )


class ShapeError(StoneError):
    """An array has another shape than the function is defined for."""

    code = "bad_shape"

    def __init__(self, name: str, shape: tuple[int, ...], expected: str) -> None:
        super().__init__(f"{name} has shape {shape}; expected {expected}")


class PlatformFaultError(Refused):
    """Not the input is at fault but the machine, for now: a job that meets one of these is tried again."""
