"""Several Python threads render at once: nothing aborts, and every thread gets its own picture.

With torch in both modes and with Dr.Jit, with different options, the first time and again. A race
in Dr.Jit ends the process, so each try is a process of its own.
"""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

TRIES = 2  # processes

PROGRAM = """
import threading
import torch
from torch.autograd import forward_ad
from gva_mi.splat import SplatOptions, drjit_render, exclusive, render
from gva_mi.splat.scene import random_scene
from gva_mi.splat.gaussians import Gaussians
import drjit as dr
from drjit.llvm import ad

OPTIONS = [SplatOptions(), SplatOptions(depth=False)]

def scene(number):
    s = random_scene(torch.Generator().manual_seed(0), 400, 90, 70).to(torch.float32)
    return s.with_inputs(s.inputs() | {"colors": s.gaussians.colors / (1 + number)})

def both(s, options):
    image = render(s.gaussians, s.camera, options, s.background)
    return [image.color, *torch.autograd.grad(image.color.square().sum(), s.gaussians.means)]

def forward(s, options):
    g = s.gaussians
    with torch.no_grad(), forward_ad.dual_level():
        means = forward_ad.make_dual(g.means.detach(), torch.ones_like(g.means))
        moved = Gaussians(means, g.quats, g.scales, g.opacities, g.colors)
        color = render(moved, s.camera, options).color
        return list(forward_ad.unpack_dual(color))

def native(s, options):
    with exclusive:  # for Dr.Jit's own autodiff too
        arrays = {k: ad.TensorXf(v.detach().numpy()) for k, v in s.gaussians.arrays().items()}
        dr.enable_grad(arrays["means"])
        color = drjit_render.render(Gaussians(**arrays), s.camera, options).color
        dr.backward(dr.sum(dr.square(color)))
        return [torch.tensor(x.numpy()) for x in (color, dr.grad(arrays["means"]))]

def numbers(parts):
    return [part.detach().numpy().tobytes() for part in parts]

def work(number, start, found):
    s = scene(number)
    start.wait()
    found[number] = [numbers(WAYS[number](s, options)) for options in OPTIONS]

def together():
    found, start = {}, threading.Barrier(len(WAYS))
    threads = [threading.Thread(target=work, args=(k, start, found)) for k in range(len(WAYS))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found

WAYS = [both, both, forward, native]
found = together()
alone = [[numbers(way(scene(k), options)) for options in OPTIONS] for k, way in enumerate(WAYS)]
assert [found[k] for k in range(len(WAYS))] == alone
assert together() == found
print("the same bits")
"""


def run(_):
    command = [sys.executable, "-c", PROGRAM]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def test_threads_render_for_the_first_time_and_again():
    with ThreadPoolExecutor(2) as pool:
        for found in pool.map(run, range(TRIES)):
            assert (found.returncode, found.stdout) == (0, "the same bits\n"), found.stderr


FORKED = """
import os, sys
import torch
from gva_mi.splat import render
from gva_mi.splat.scene import random_scene

s = random_scene(torch.Generator().manual_seed(0))
render(s.gaussians, s.camera)
if os.fork() == 0:
    try:
        render(s.gaussians, s.camera)
    except RuntimeError as error:
        print(error, flush=True)
    os._exit(0)
os.wait()
loader = torch.utils.data.DataLoader(range(4), num_workers=1, multiprocessing_context="fork")
for _ in loader:
    render(s.gaussians, s.camera)
print("the parent goes on")
"""


def test_a_forked_process_cannot_render_but_may_load():
    found = subprocess.run(
        [sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=300
    )
    child, parent = found.stdout.splitlines()
    assert "this process was forked" in child and parent == "the parent goes on", found.stderr


IDLE = """
import os, time
import torch
from gva_mi.splat import render
from gva_mi.splat.scene import random_scene

torch.set_num_threads(3)
s = random_scene(torch.Generator().manual_seed(0))
numbers = torch.randn(3_000_000)
render(s.gaussians, s.camera)
threads = lambda: len(os.listdir("/proc/self/task"))
before, total = threads(), numbers.sum()
woken = threads() - before
render(s.gaussians, s.camera)
until = time.monotonic() + 60
while threads() > before and time.monotonic() < until:
    time.sleep(0.01)
print(woken, threads() - before, torch.get_num_threads(), torch.equal(numbers.sum(), total))
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="counts threads on Linux")
def test_torchs_idle_threads_are_gone_while_kernels_run_and_come_back():
    found = subprocess.run(
        [sys.executable, "-c", IDLE], capture_output=True, text=True, timeout=300
    )
    assert found.stdout.split() == ["2", "0", "3", "True"], found.stderr
