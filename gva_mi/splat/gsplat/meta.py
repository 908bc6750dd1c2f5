"""The dictionary ``meta``: its entries are computed when they are read.

Most programs read a few entries, and only in some steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, MutableMapping
from typing import Any

Recipe = Callable[[], Any]


class Meta(MutableMapping):
    """A dictionary; some of its values are computed at the first reading."""

    def __init__(self, values: dict[str, Any], recipes: dict[str, Recipe]) -> None:
        self._values, self._recipes = dict(values), dict(recipes)

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401
        if name not in self._values and name in self._recipes:
            self._values[name] = self._recipes.pop(name)()
        return self._values[name]

    def __setitem__(self, name: str, value: Any) -> None:  # noqa: ANN401
        self._recipes.pop(name, None)
        self._values[name] = value

    def __delitem__(self, name: str) -> None:
        if self._recipes.pop(name, None) is None:
            del self._values[name]

    def __iter__(self) -> Iterator[str]:
        yield from [*self._values, *self._recipes]

    def __len__(self) -> int:
        return len(self._values) + len(self._recipes)

    def __repr__(self) -> str:
        return f"Meta({', '.join(self)})"
