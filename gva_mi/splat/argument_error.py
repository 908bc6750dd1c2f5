"""The error for an argument that a function refuses, in parts, so that a caller can rename it."""

from __future__ import annotations


class ArgumentError(ValueError):
    """``function: name[index] problem``: which argument is wrong, where in it, and why."""

    def __init__(self, function: str, name: str, problem: str, index: str = "") -> None:
        super().__init__(function, name, problem, index)  # all of args: errors are pickled by them

    def __str__(self) -> str:
        function, name, problem, index = self.args
        return f"{function}: {name}{index} {problem}"

    def renamed(self, function: str, names: dict[str, str]) -> ArgumentError:
        """Return the error of another function, whose arguments have other names."""
        _, name, problem, index = self.args
        return ArgumentError(function, names.get(name, name), problem, index)
