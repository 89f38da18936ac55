"""The root of all errors that the platform raises on purpose, and the most common one, `Refused`.

**Conventions.** A refusal is `Refused(code, sentence)`; the sentence contains value, limit and likely mistake.
Subclasses exist only if some code catches them or reads their attributes. In docstrings, "Raises `upload_locked`" names
the code. No code raises a bare `StoneError`.
"""


def one_line(text: str) -> str:
    """Return `text` with unprintable characters escaped: quoted input may contain line ends and terminal commands."""
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in text)


class StoneError(Exception):
    """A refused input or state; `code` is the reason for programs, the sentence is for people."""

    code: str

    def __init__(self, sentence: str) -> None:
        super().__init__(one_line(sentence))

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the finished sentence (worker → parent), because some classes take other arguments than a sentence."""
        return _restored, (type(self), self.args, self.__dict__)


def _restored(leaf: type[StoneError], args: tuple[object, ...], facts: dict[str, object]) -> StoneError:
    error = leaf.__new__(leaf)
    error.args = args
    error.__dict__.update(facts)
    return error


class Refused(StoneError):  # noqa: N818
    """A refusal that callers identify by its code."""

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
    """An array whose shape the function does not accept."""

    code = "bad_shape"

    def __init__(self, name: str, shape: tuple[int, ...], expected: str) -> None:
        super().__init__(f"{name} has shape {shape}; expected {expected}")


class PlatformFaultError(Refused):
    """A temporary fault of the machine, not of the input: jobs retry after this error."""
