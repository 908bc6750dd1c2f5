"""What JSON says becomes a dataclass, or an error at the door."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import pytest

from gva_mi.ranges import Within
from gva_mi.records import from_json


@dataclass(frozen=True)
class Inner:
    share: Annotated[float, Within(0, 1)]
    name: str | None = None


@dataclass(frozen=True)
class Outer:
    count: int
    kind: Literal["a", "b"]
    inner: Inner
    several: tuple[Inner, ...] = ()
    size: tuple[int, int] = (1, 2)
    by_name: dict[str, float] | None = None
    lists: Mapping[str, list[str]] | None = None
    anything: Any = None
    on: bool = False


WHOLE = Outer(
    3, "b", Inner(0.5), (Inner(1, "x"), Inner(0.25)), (4, 6), {"p": 1.5}, {"q": ["r"]}, [1], True
)


def test_what_was_written_comes_back():
    assert from_json(Outer, asdict(WHOLE)) == WHOLE
    least = {"count": 1, "kind": "a", "inner": {"share": 1}}
    assert from_json(Outer, least) == Outer(1, "a", Inner(1))


@pytest.mark.parametrize("name, value", [
    ("count", 2.5), ("count", "3"), ("count", True), ("count", None), ("kind", "c"), ("kind", []),
    ("kind", {"a": 1}), ("inner", 3), ("inner", {}), ("inner", {"share": "x"}), ("inner", None),
    ("inner", {"share": 1, "more": 2}), ("several", {"share": 1}), ("several", [[1]]),
    ("size", [1]), ("size", [1, 2, 3]), ("size", [1, "2"]), ("by_name", {"p": "1"}),
    ("by_name", [1]), ("lists", {"q": "r"}), ("lists", {"q": [1]}), ("on", 1), ("unknown", 1),
])  # fmt: skip
def test_a_value_of_another_kind_is_an_error_that_names_it(name, value):
    with pytest.raises(TypeError):
        from_json(Outer, asdict(WHOLE) | {name: value})


def test_a_record_that_is_none():
    for found in (None, [], 3, "text"):
        with pytest.raises(TypeError, match="in the place of a Outer"):
            from_json(Outer, found)
    with pytest.raises(TypeError, match="count"):
        from_json(Outer, {"kind": "a", "inner": {"share": 1}})
