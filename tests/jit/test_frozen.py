"""A frozen function is traced once per set of constants, and never confuses two sets."""

import gc

import drjit as dr
import pytest
from drjit.llvm import Float

from gva_mi.jit.frozen import Frozen


def opaque(size):
    x = dr.arange(Float, size)
    dr.make_opaque(x)
    return x


def recordings(function):
    """Count the recordings of a frozen function."""
    return sum(variant.n_recordings for variant in function.variants.values())


def test_traced_once_for_any_size():
    calls = []

    @Frozen
    def doubled(x):
        calls.append(1)
        return 2 * x

    for size in (3, 5, 8):
        assert dr.all(doubled(opaque(size)) == 2 * dr.arange(Float, size))
    assert len(calls) == recordings(doubled) == 1


def test_equal_constants_are_distinguished():
    @Frozen
    def chosen(x, *, a, b, c):
        return x + (1 if a else 2) + (10 if b else 20) + (100 if c else 200)

    for _ in range(2):
        for a in (True, False):
            for b in (True, False):
                for c in (True, False):
                    expected = (1 if a else 2) + (10 if b else 20) + (100 if c else 200)
                    assert chosen(opaque(4), a=a, b=b, c=c)[0] == expected
    assert recordings(chosen) == 8


def test_no_garbage_is_collected_in_a_recording():
    """Nor afterwards, where the caller had switched it off; and an error leaves it as it was."""
    seen = []

    @Frozen
    def looked(x, *, fails):
        seen.append(gc.isenabled())
        if fails:
            raise ValueError("as asked")
        return x + 1

    assert gc.isenabled()
    looked(opaque(3), fails=False)
    assert seen == [False] and gc.isenabled()
    gc.disable()
    try:
        looked(opaque(3), fails=False)
        assert not gc.isenabled()
    finally:
        gc.enable()
    with pytest.raises((ValueError, RuntimeError)):
        looked(opaque(3), fails=True)
    assert gc.isenabled()
