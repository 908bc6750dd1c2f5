"""Every stage is measured, and its work is counted in the code that runs."""

import drjit as dr
import pytest
from drjit.llvm import Float, UInt

from gva_mi.splat.bench.machine import Limits
from gva_mi.splat.bench.stages import COUNTED, STAGES, measure_stages, operations
from gva_mi.splat.kernels.blend import PIXELS, UNROLL


@pytest.fixture(scope="module")
def stages(work):
    return list(measure_stages(work, 2, Limits(gflops=100.0, gigabytes=10.0, threads=1)))


def test_every_stage_is_measured(stages):
    assert [stage.name for stage in stages] == list(STAGES)
    for stage in stages:
        assert 0 < stage.time.least <= stage.time.median
        assert stage.share_bytes == pytest.approx(stage.gigabytes / 10)
    assert {stage.name for stage in stages if stage.share_flops} == set(COUNTED)


def test_watches_are_taken_off(stages):
    for module, function in STAGES.values():
        assert "wrapped" not in getattr(getattr(module, function), "__qualname__", "")
    assert not dr.flag(dr.JitFlag.KernelHistory)


def test_operations_are_those_of_the_loops_body():
    def body(k, a, b):
        for _ in range(5):
            a, b = dr.fma(a, b, a), b * b + 1
        return k + 1, a, b

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        x = dr.opaque(Float, 0.5, 40)
        last = dr.opaque(UInt, 7)
        state = (dr.zeros(UInt, 40), x, x + 1)
        _, a, b = dr.while_loop(state, lambda k, *_: k < last, body, mode="symbolic")
        dr.eval(a * b)
        kernels = dr.kernel_history((dr.KernelType.JIT,))
    assert max(operations(kernel["ir"].getvalue()) for kernel in kernels) == 5 * 4
    assert operations("define void @no_loop() {}") == 0


def test_a_pixel_takes_at_least_what_its_equations_need(work, stages):
    """Exponent 5, its power of two 10, T and the weight 3, four features 8."""
    turn = {}
    for stage in stages:
        if stage.name in COUNTED:
            turn[stage.name] = stage.gflops * 1e6 * stage.time.least
    from gva_mi.splat.bench.timing import walked_of

    pixels = walked_of(work.saved()) * PIXELS
    forward, adjoint = (turn[name] / pixels for name in COUNTED)
    assert 26 <= forward < 60 and forward < adjoint < 120
    assert UNROLL >= 1
