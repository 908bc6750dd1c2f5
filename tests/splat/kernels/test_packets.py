"""What is stored in packets is what is loaded."""

import drjit as dr
import pytest
from drjit.llvm import Float, Float64, UInt32

from gva_mi.splat.kernels import packets


@pytest.mark.parametrize("columns", range(1, 20))
def test_widths_are_powers_of_two_that_add_up(columns):
    widths = packets.widths(columns)
    assert sum(widths) == columns
    assert set(widths) <= {1, 2, 4, 8}
    assert widths == sorted(widths, reverse=True)


@pytest.mark.parametrize("F", [Float, Float64])
@pytest.mark.parametrize("columns", [1, 3, 10, 15])
def test_load_undoes_store(F, columns):
    rows = 7
    index = rows - 1 - dr.arange(UInt32, rows)
    written = [F(index) * 100 + k for k in range(columns)]
    memory = packets.empty(F, columns, rows)
    packets.store(memory, written, index)
    read = packets.load(memory, columns, index)
    assert all(dr.all(a == b) for a, b in zip(written, read, strict=True))
    assert all(type(a) is F for a in read)
