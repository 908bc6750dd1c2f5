"""The one error a user can cause: input that does not have the expected form."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class InputError(ValueError):
    """A file, folder or option that cannot be used, in one sentence.

    The sentence names what was found, where, and which form was expected. The command line prints
    it and leaves with exit code 2; everything else is a bug and keeps its traceback.
    """


# What Python, numpy and torch raise for content that is not of the form which a reader counts on.
MALFORMED = (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)


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
    """The first line of what an error says, without what would move a terminal's cursor."""
    line = next(iter(str(error).splitlines()), "")
    line = "".join(c if c.isprintable() else "?" for c in line[:160])
    name = type(error).__name__
    return f"{name}: {line}" if line and isinstance(error, KeyError) else line or name
