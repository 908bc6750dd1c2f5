"""The one error that a user can cause: input without the expected form."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST = 1500  # characters of a sentence


class InputError(ValueError):
    """A file, folder or option that cannot be used, described in one sentence.

    The sentence names what was found, where, and the expected form. The command line prints it and
    exits with code 2; every other exception is a bug and keeps its traceback. Control characters
    quoted from a file are removed, and long sentences are cut.
    """

    def __init__(self, sentence: str = "") -> None:
        line = "".join(c if c.isprintable() else " " for c in sentence)
        super().__init__(line if len(line) <= LONGEST else f"{line[:LONGEST]} ...")


# What Python, numpy and torch raise when a file's content does not have the form a reader expects.
MALFORMED = (
    ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, StopIteration,
    TypeError, ValueError,
)  # fmt: skip


@contextmanager
def expecting(where: Path | str, expected: str) -> Iterator[None]:
    """Turn any error caused by malformed content of a file into an InputError.

    ``expected`` says what the file should hold.
    """
    try:
        yield
    except InputError:
        raise
    except MALFORMED as error:
        reason = reason_of(error)
        raise InputError(f"{where}: of another form ({reason}); expected {expected}") from None


def reason_of(error: BaseException) -> str:
    """Return the first line of an error's message, or its class if it has none."""
    line = next(iter(str(error).splitlines()), "")[:160]
    name = type(error).__name__
    return f"{name}: {line}" if line and isinstance(error, KeyError) else line or name
