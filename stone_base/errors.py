"""The root of every error the platform raises on purpose.

**Conventions.** A leaf is a subclass with a `code` of its own. Its constructor takes the facts and writes one
sentence that quotes the value, the limit and the likely mistake. Nothing is raised as a bare `StoneError`.
"""

from typing import ClassVar


def one_line(text: str) -> str:
    """`text` with what is not printable escaped: what it quotes may hold line ends and commands to a terminal."""
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in text)


class StoneError(Exception):
    """An input or a state is refused; `code` names the reason for programs, the sentence for people."""

    code: ClassVar[str]

    def __init__(self, sentence: str) -> None:
        super().__init__(one_line(sentence))

    def __reduce__(self) -> tuple[object, ...]:
        """Leaves take facts, not sentences, so a pickle carries the finished sentence (worker → parent)."""
        return _restored, (type(self), self.args, self.__dict__)


def _restored(leaf: type[StoneError], args: tuple[object, ...], facts: dict[str, object]) -> StoneError:
    error = leaf.__new__(leaf)
    error.args = args
    error.__dict__.update(facts)
    return error


class ShapeError(StoneError):
    """An array has another shape than the function is defined for."""

    code = "bad_shape"

    def __init__(self, name: str, shape: tuple[int, ...], expected: str) -> None:
        super().__init__(f"{name} has shape {shape}; expected {expected}")


class PlatformFaultError(StoneError):
    """Not the input is at fault but the machine, for now: a job that meets one of these is tried again."""
