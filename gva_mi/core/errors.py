"""The one error that a user can cause: input without the expected form."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Characters of a sentence; longer ones are cut. Chosen: a few lines of a terminal per quoted path.
LONGEST_SENTENCE = 1500


class InputError(ValueError):
    """A file, folder or option that cannot be used, described in one sentence.

    The sentence names what was found, where, and the expected form. The command line prints it and
    exits with code 2; every other exception is a bug and keeps its traceback. Control characters
    quoted from a file are removed, and long sentences are cut.
    """

    def __init__(self, sentence: str = "") -> None:
        line = "".join(c if c.isprintable() else " " for c in sentence)
        super().__init__(
            line if len(line) <= LONGEST_SENTENCE else f"{line[:LONGEST_SENTENCE]} ..."
        )


# What Python, numpy and torch raise when a file's content does not have the form a reader expects.
MALFORMED = (
    ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, StopIteration,
    TypeError, ValueError,
)  # fmt: skip


@contextmanager
def expecting(where: Path | str, expected: str) -> Iterator[None]:
    """Turn any error caused by malformed content of a file into an InputError.

    ``expected`` says what the file should hold.

    Example:
        >>> with expecting("poses.json", "a list of poses"):
        ...     {}["frames"]
        Traceback (most recent call last):
        gva_mi.core.errors.InputError: poses.json: unexpected format ('frames' is missing); ...
    """
    try:
        yield
    except InputError:
        raise
    except MALFORMED as error:
        reason = reason_of(error)
        raise InputError(f"{where}: unexpected format ({reason}); expected {expected}") from None


# Plain words for Python's own messages, which describe a program and not a file.
_PLAIN_WORDS = (
    (KeyError, "'{}' is missing"),
    (UnicodeError, "it is not text in UTF-8"),
    (RecursionError, "it is nested too deeply"),
    (ArithmeticError, "a number is zero or too large"),
    ((LookupError, StopIteration, EOFError, struct.error), "a value is missing"),
    ((AttributeError, TypeError, AssertionError), "a value has the wrong type"),
)
_LENGTHS = re.compile(
    "values to unpack|inhomogeneous|ambiguous|broadcast|reshape|invalid for input|must match|"
    "zip|zero-size|empty (sequence|iterable)|at least one array|[Dd]imension"
)
_NO_MEMORY = re.compile("allocate memory|out of memory|failed to map segment|start new thread")


def reason_of(error: BaseException) -> str:
    """Return in one line of plain words why a reader failed.

    Messages of our own, of file systems and of decoders are kept as they are.

    Raises:
        MemoryError: the machine had too little memory, which is no fault of a file.
    """
    if is_memory(error):
        raise error
    if strerror := getattr(error, "strerror", None):  # FFmpeg's errors have it, too
        return strerror
    for kind, words in _PLAIN_WORDS:
        if isinstance(error, kind):
            return words.format(*error.args[:1] or ("",))
    line = " ".join(str(error).split()).split(". ")[0][:160]  # torch goes on with advice
    if isinstance(error, ValueError | RuntimeError) and _LENGTHS.search(line):
        return "a list or an array has the wrong length"
    return line or type(error).__name__


def is_memory(error: BaseException) -> bool:
    """Return whether memory ran out; torch and the system report it by other exceptions."""
    if isinstance(error, MemoryError):
        return not hasattr(error, "errno")  # FFmpeg raises it, with errno, for damaged videos
    return isinstance(error, RuntimeError | ImportError) and bool(_NO_MEMORY.search(str(error)))
