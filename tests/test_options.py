"""Options have ranges that hold in Python too; JSON becomes a dataclass or an error."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal, get_type_hints

import pytest

from gva_mi.avatar.canonical import SeedOptions
from gva_mi.avatar.densify import DensifyOptions
from gva_mi.avatar.reinit import ReinitOptions
from gva_mi.avatar.residual import ResidualOptions
from gva_mi.avatar.rig import SkinningOptions
from gva_mi.core.errors import InputError
from gva_mi.core.options import Within, from_json, ranges, require_ranges
from gva_mi.fit.losses import LossOptions
from gva_mi.fit.options import FitOptions, Rates, Schedule
from gva_mi.fit.photometric import PhotometricOptions
from gva_mi.fit.poses import PoseOptions
from gva_mi.fit.renders import CameraPath
from gva_mi.refine import SequenceOptions, SingleFrameOptions
from gva_mi.splat import SplatOptions

KINDS = (CameraPath, DensifyOptions, FitOptions, LossOptions, PhotometricOptions, PoseOptions,
    Rates, ReinitOptions, ResidualOptions, Schedule, SeedOptions, SequenceOptions,
    SingleFrameOptions, SkinningOptions, SplatOptions)  # fmt: skip


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


def test_a_record_comes_back():
    assert from_json(Outer, asdict(WHOLE)) == WHOLE


WRONG = [
    ("count", 2.5), ("count", "3"), ("count", True), ("count", None), ("kind", "c"), ("kind", []),
    ("kind", {"a": 1}), ("inner", 3), ("inner", {}), ("inner", {"share": "x"}), ("inner", None),
    ("inner", {"share": 1, "more": 2}), ("several", {"share": 1}), ("several", [[1]]),
    ("size", [1]), ("size", [1, 2, 3]), ("size", [1, "2"]), ("by_name", {"p": "1"}),
    ("by_name", [1]), ("lists", {"q": "r"}), ("lists", {"q": [1]}), ("on", 1), ("unknown", 1),
]  # fmt: skip


def test_a_value_of_another_type_is_an_error():
    for name, value in WRONG:
        with pytest.raises(ValueError):
            from_json(Outer, asdict(WHOLE) | {name: value})

    for found in (None, [], 3, "text"):
        with pytest.raises(ValueError, match="expected an Outer, got"):
            from_json(Outer, found)
    with pytest.raises(ValueError, match="count"):
        from_json(Outer, {"kind": "a", "inner": {"share": 1}})
    with pytest.raises(ValueError, match="^'unknown' is unknown$"):
        from_json(Outer, asdict(WHOLE) | {"unknown": 1})


@pytest.mark.parametrize("kind", KINDS)
def test_ranges_hold_for_options_made_in_python(kind):
    for name, hint in get_type_hints(kind, include_extras=True).items():
        for _, within in ranges(hint):
            for bad in (float("nan"), float("inf"), 2 * within.high + 1, within.low - 1):
                with pytest.raises(
                    InputError, match=rf"^\w+: {name} must be (from|above) .*, got "
                ):
                    kind(**{name: bad})


def test_a_number_of_steps_is_a_whole_one():
    with pytest.raises(InputError, match=r"fit: steps must be a whole number, got 2\.5"):
        FitOptions(steps=2.5)


def test_the_ends_belong_to_a_range_unless_it_is_open():
    assert 0 in Within(0, 1) and 1.0 in Within(0, 1) and float("nan") not in Within(0, 1)
    assert 0 not in Within(0, 1, "low") and 1 in Within(0, 1, "low")
    assert not {0, 1} & {x for x in (0, 1, 0.5) if x in Within(0, 1, "low high")}
    assert True not in Within(0, 1) and "1" not in Within(0, 1)
    told = [str(Within(0, 1e6)), str(Within(0, 2, "low")), str(Within(1, 9, "low high", "px"))]
    assert told == ["from 0 to 1,000,000", "above 0 and at most 2", "above 1 and below 9 px"]


def test_each_of_several_numbers_is_checked():
    @dataclass
    class Options:
        shares: tuple[Annotated[float, Within(0, 1)], ...] = ()
        height: Annotated[float, Within(0, 3)] | None = None

    require_ranges("fit", Options((0.5, 1.0)))
    with pytest.raises(InputError, match="fit: shares must be from 0 to 1, got 2"):
        require_ranges("fit", Options((0.5, 2)))
    with pytest.raises(InputError, match="fit: height must be from 0 to 3, got 4"):
        require_ranges("fit", Options(height=4))
