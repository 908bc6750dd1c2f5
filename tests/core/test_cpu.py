"""Other processors give the same bits: library settings, and kernels of any vector width."""

import ast
import ctypes
import json
import os
import platform
import subprocess
import sys
from functools import cache
from pathlib import Path

import drjit as dr
import numpy as np
import pytest
import torch

from gva_mi.core import cpu
from gva_mi.core.cpu import core_for_torch, in_torch_thread, one_torch_thread, sqrt

ROOT = Path(__file__).parents[2]
LEDGER = Path(__file__).with_name("ledger")  # whose scenes are drawn here, too
OURS = [path for folder in ("gva_mi", "plugins") for path in (ROOT / folder).rglob("*.py")]
ESTIMATED = {"rsqrt", "normalize"}  # Dr.Jit functions that use the processor's estimate
SET_TARGET = "_Z19jit_llvm_set_targetPKcS0_j"  # (processor, features, lanes) of Dr.Jit 1.5
CORE = Path(dr.__file__).parent / "libdrjit-core.so"

HASHES = """
import ctypes, json, sys
import torch
import gva_mi
import drjit as dr
from drjit.llvm import Float
dr.eval(Float(1, 2) + 1)  # the backend starts with this processor's width
if len(sys.argv) > 1:
    core, name, processor, features, lanes = sys.argv[1:]
    set_target = getattr(ctypes.CDLL(core), name)
    set_target.argtypes = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_uint32]
    set_target(processor.encode(), features.encode(), int(lanes))
from gva_mi.avatar.lbs_transforms import SparseWeights
from gva_mi.avatar.skin_gaussians import skin_gaussians
from gva_mi.body.polar import apply_lbs
from sums import mesh_normals, of_tensors, splatting

found = {"rsqrt": of_tensors([dr.rsqrt(dr.arange(Float, 1000) + 0.3).torch()])}
found |= dict(splatting()) | dict(mesh_normals())
def add(name, out, inputs):
    weights = torch.linspace(-1, 1, out.numel(), dtype=out.dtype).reshape(out.shape)
    found[name] = of_tensors([out])
    for k, grad in enumerate(torch.autograd.grad((out * weights).sum(), inputs, retain_graph=True)):
        found[f"{name}, adjoint {k}"] = of_tensors([grad])

generator = torch.Generator().manual_seed(0)
random = lambda *shape: torch.randn(*shape, generator=generator)
A = (torch.eye(3, 4).reshape(12) + 0.3 * random(300, 12)).requires_grad_()
means, quats, scales = random(300, 3), random(300, 4), random(300, 3).exp()
given = random(9, 4, 4).double(), means, quats, scales, random(300, 4, 3), random(3)
inputs = [x.clone().requires_grad_() for x in given]
weights = SparseWeights.of(random(300, 9).softmax(1), random(300, 3, 9))
outs = skin_gaussians(weights, *inputs)
add("skinned", torch.cat([x.flatten() for x in outs]), inputs)
for name, out in zip(("means", "frames"), apply_lbs(A, means, quats)):
    add(name, out, [A])
print(json.dumps(found))
"""


FOUR_LANES = "x86-64-v3", "+avx2,+fma,+f16c", 4
INTEL = "skylake-avx512", "+avx512f,+avx512vl,+avx512dq,+avx512bw,+avx512cd,+fma,+f16c", 16


@cache
def hashes(*target):
    target = (str(CORE), SET_TARGET, *map(str, target)) if target else ()
    code = f"import sys; sys.path.append({str(LEDGER)!r})" + HASHES
    done = subprocess.run(
        [sys.executable, "-c", code, *target], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_no_kernel_uses_an_estimate():
    for path in OURS:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                asks = node.value.id in ("dr", "mi") and node.attr in ESTIMATED
                assert not asks, f"{path}:{node.lineno}: {node.attr}; divide by the norm"


def test_no_tensor_goes_through_the_vector_functions_of_mkl():
    """Their last digits differ between makers of CPUs; the docstring of ``cpu.sqrt`` says why."""
    of_mkl = {"sqrt", "acos", "asin", "atan"}
    exact = {"np", "math", "dr", "mi"}
    for path in OURS:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and node.attr in of_mkl:
                known = isinstance(node.value, ast.Name) and node.value.id in exact
                assert known, f"{path}:{node.lineno}: {node.attr}; see sqrt in gva_mi/core/cpu.py"


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_square_root_is_within_one_unit_of_the_last_place(dtype):
    x = torch.rand(10_000, dtype=dtype, generator=torch.Generator().manual_seed(0)) * 3
    exact = torch.from_numpy(np.sqrt(x.numpy().astype(np.longdouble)).astype(np.float64))
    assert ((sqrt(x).double() / exact - 1).abs() < 1.5 * torch.finfo(dtype).eps).all()
    assert sqrt(torch.zeros(1, dtype=dtype)) == 0


@pytest.mark.parametrize("dtype, least", [(torch.float32, 2e-26), (torch.float64, 3.1e-206)])
def test_the_gradient_of_the_square_root_is_that_of_torch_except_where_it_overflows(dtype, least):
    def gradient(root, values):
        x = torch.tensor(values, dtype=dtype, requires_grad=True)
        return torch.autograd.grad(root(x).sum(), x)[0]

    values = [2 * least, 1e-20, 0.3, 1.0, 1e20]
    found, expected = gradient(sqrt, values), gradient(torch.sqrt, values)
    assert ((found / expected - 1).abs() < 4 * torch.finfo(dtype).eps).all()
    assert gradient(sqrt, [0.5 * least]).isinf() and gradient(sqrt, [0.0]).isnan()
    norm = lambda root: lambda x: root(x.square().sum())
    for root in (sqrt, torch.sqrt):
        assert gradient(norm(root), [0.0, 0.0]).isnan().all()


NARROW = platform.machine() == "x86_64" and cpu.cpu_settings() and CORE.exists()
NARROW = NARROW and hasattr(ctypes.CDLL(str(CORE)), SET_TARGET)
WIDE = NARROW and "avx512cd" in Path("/proc/cpuinfo").read_text()


@pytest.mark.skipif(not NARROW, reason="needs x86 with AVX2, and Dr.Jit 1.5")
def test_kernels_give_the_same_bits_in_vectors_of_any_width():
    own, four = hashes(), hashes(*FOUR_LANES)
    assert own.keys() == four.keys() and len(own) > 8
    # The estimate must differ, or the two widths would be indistinguishable.
    assert {k for k in own if own[k] != four[k]} == {"rsqrt"}


@pytest.mark.skipif(not WIDE, reason="needs x86 with AVX-512, and Dr.Jit 1.5")
def test_kernels_compile_for_processors_that_write_half_a_vector_at_a_time():
    """Intel's, where LLVM calls a function to clear more than 512 bytes, which Dr.Jit refuses."""
    own, intel = hashes(), hashes(*INTEL)
    assert any("float64" in name for name in intel)
    assert {name for name in own if own[name] != intel[name]} <= {"rsqrt"}


def test_the_command_line_pins_libraries_before_they_are_imported():
    code = (
        "import sys, os; from gva_mi.__main__ import main; from gva_mi.core import cpu; "
        "before = {'numpy', 'torch', 'drjit'} & set(sys.modules); "
        "main(['--version']); "
        "print(before, all(os.environ[k] == v for k, v in cpu.cpu_settings().items()))"
    )
    clean = {k: v for k, v in os.environ.items() if k not in cpu.SETTINGS}
    run = lambda env: (
        subprocess.run(
            [sys.executable, "-c", code], env=env, capture_output=True, text=True, cwd=ROOT
        ).stdout
    )
    assert run(clean).endswith("set() True\n")
    if cpu.cpu_settings():
        assert run(clean | {"OPENBLAS_CORETYPE": "Prescott"}).endswith("set() False\n")


@pytest.mark.parametrize("machine, flags, pinned, wide", (
    ("x86_64", "fpu avx avx2 fma", True, False), ("x86_64", "avx2 fma avx512f", True, True),
    ("x86_64", "fpu avx fma", False, False), ("aarch64", "avx2 fma", False, False),
))  # fmt: skip
def test_what_is_wider_than_avx2_is_left_out(machine, flags, pinned, wide, tmp_path, monkeypatch):
    from numpy._core._multiarray_umath import __cpu_dispatch__

    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(cpu, "_FLAGS", tmp_path / "cpuinfo")
    (tmp_path / "cpuinfo").write_text(f"processor : 0\nflags\t\t: {flags}\n")
    found = cpu.cpu_settings()
    there = {name for name in __cpu_dispatch__ if name == "X86_V4" or "512" in name}
    assert bool(found) == pinned
    assert set(found.get(cpu.LEFT_OUT_BY_NUMPY, "").split()) == (there if wide else set())


def test_work_beside_gives_the_same_bits_with_the_callers_number_of_threads():
    count, x, weight = torch.get_num_threads, torch.rand(1, 3, 40, 40), torch.rand(16, 3, 3, 3)
    before = count()
    assert in_torch_thread(count).result() == before
    with one_torch_thread():
        assert in_torch_thread(count).result() == 1
        there, here = in_torch_thread(torch.conv2d, x, weight), torch.conv2d(x, weight)
        assert torch.equal(there.result(), here)
    assert in_torch_thread(count).result() == before == count()
    with pytest.raises(RuntimeError, match="size"):
        in_torch_thread(torch.add, torch.zeros(2), torch.zeros(3)).result()


def test_drjit_leaves_torch_a_core_and_gets_it_back_also_after_an_error():
    before = dr.thread_count()
    try:
        for threads, left in ((2, 1), (1, 1)):
            dr.set_thread_count(threads)
            with pytest.raises(ZeroDivisionError), core_for_torch():
                assert dr.thread_count() == left
                1 / 0  # noqa: B018
            assert dr.thread_count() == threads
    finally:
        dr.set_thread_count(before)
