"""How many bytes a file may unfold to, and the two ways to refuse it."""

from __future__ import annotations

LARGEST = 4 << 30  # bytes that one file may unfold to: its arrays, and what was compressed


class Refused(Exception):  # noqa: N818 (a verdict, turned into an InputError by the reader)
    """What a file holds is not on the list; the message says what it is."""


class Damaged(Exception):  # noqa: N818
    """A file contradicts itself, or ends too early; the message says how."""


class Budget:
    """Bytes that may still be made of one file."""

    def __init__(self, size: int = LARGEST) -> None:
        self.left = size

    def spend(self, size: int) -> None:
        """Take ``size`` bytes, before they are allocated.

        Raises:
            Refused: there are not as many left.
        """
        if size > self.left:
            raise Refused(f"contents that unfold to more than {LARGEST >> 30} GiB")
        self.left -= size
