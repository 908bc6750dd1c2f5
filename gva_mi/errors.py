"""The one error a user can cause: input that does not have the expected form."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST = 1500  # characters of a sentence


class InputError(ValueError):
    """A file, folder or option that cannot be used, in one sentence.

    The sentence names what was found, where, and which form was expected. The command line prints
    it and leaves with exit code 2; everything else is a bug and keeps its traceback. Words of a
    file that it quotes move no cursor and fill no screen.
    """

    def __init__(self, sentence: str = "") -> None:
        line = "".join(c if c.isprintable() else " " for c in sentence)
        super().__init__(line if len(line) <= LONGEST else f"{line[:LONGEST]} ...")


# What Python, numpy and torch raise for content that is not of the form which a reader counts on.
MALFORMED = (
    ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, StopIteration,
    TypeError, ValueError,
)  # fmt: skip


@contextmanager
def expecting(where: Path | str, expected: str) -> Iterator[None]:
    """Whatever fails within is the fault of a file's content, and becomes one sentence.

    Args:
        where: the file.
        expected: what it should hold.

    Raises:
        InputError: for any error that content of another form leads to.
    """
    try:
        yield
    except InputError:
        raise
    except MALFORMED as error:
        reason = reason_of(error)
        raise InputError(f"{where}: of another form ({reason}); expected {expected}") from None


def reason_of(error: BaseException) -> str:
    """The first line of what an error says; else its kind."""
    line = next(iter(str(error).splitlines()), "")[:160]
    name = type(error).__name__
    return f"{name}: {line}" if line and isinstance(error, KeyError) else line or name
