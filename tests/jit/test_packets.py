"""Records are loaded as they were stored."""

from dataclasses import fields

import drjit as dr
import pytest
from drjit.llvm import Float, Float64, UInt32

from gva_mi.jit import packets
from gva_mi.splat.kernels.records import (
    CameraGradient,
    Footprint,
    PairGradient,
    RecordFormat,
    Splat,
)


def test_widths_are_powers_of_two_that_add_up():
    for columns in range(1, 20):
        widths = packets.widths(columns)
        assert sum(widths) == columns and set(widths) <= {1, 2, 4, 8}
        assert widths == sorted(widths, reverse=True)


RECORDS = {
    "footprint": (Footprint, None),
    "splat": (Splat, RecordFormat(3, depth=True)),
    "one channel": (Splat, RecordFormat(1, depth=False)),
    "slot": (PairGradient, RecordFormat(8, depth=True, absolute=True)),
    "plain slot": (PairGradient, RecordFormat(3, depth=False)),
    "view": (CameraGradient, None),
}


def leaves(value):
    """The numbers of a field: itself, or the entries of a list, a vector or a matrix."""
    if isinstance(value, list | tuple):
        return [leaf for part in value for leaf in leaves(part)]
    return [value]


@pytest.mark.parametrize("F", [Float, Float64])
@pytest.mark.parametrize("name", RECORDS)
def test_load_undoes_store(F, name):
    """Every field comes back as it was, whatever the order of its columns."""
    kind, format = RECORDS[name]
    rows = 7
    index = rows - 1 - dr.arange(UInt32, rows)
    columns = [F(index) * 100 + k for k in range(kind.columns(format))]
    written = kind.unpack(columns, format)
    memory = packets.empty(kind, format, rows, F)
    packets.store(memory, written, index)
    read = packets.load(memory, kind, format, index)
    for field in fields(kind):
        before, after = (leaves(getattr(record, field.name)) for record in (written, read))
        for a, b in zip(before, after, strict=True):
            assert (a is None and b is None) or (dr.all(a == b) and type(b) is F), field.name
