"""The command ``gva-mi doctor``: check the dependencies, and what needs the missing ones."""

from __future__ import annotations

import functools
import importlib.util
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from importlib import metadata
from typing import NamedTuple

from gva_mi.core import llvm

PACKAGES = {  # that commands need, by the extra that installs them
    "mitsuba": ("mitsuba",),
    "mesh": ("pymeshlab", "trimesh", "skimage", "scipy"),
    "avatar": ("av", "PIL", "jinja2", "matplotlib", "tyro"),
}
OPTIONAL = {  # packages that most users do not need: the commands that need each, and the extra
    "ai_edge_litert": ("`gva-mi avatar`, `prepare video` and `motion VIDEO`", "video"),
    "viser": ("`gva-mi view`", "viewer"),
    "transformers": ("`gva-mi prepare --masks sam`", "sam"),
    "onnxruntime": ("`gva-mi prepare --normals FILE.onnx`", "onnx"),
    "anny": ("`gva-mi body --source anny`", "anny"),
}


class Component(NamedTuple):
    """One line of the report."""

    name: str
    found: str
    fine: bool = True

    def __str__(self) -> str:
        return f"{'ok     ' if self.fine else 'MISSING'}  {self.name:<14} {self.found}"


def doctor() -> None:
    """Check the dependencies, and report which feature needs each missing one.

    The exit code is 1 if something necessary is missing.
    """
    fine = True
    for component in examine():
        fine &= component.fine
        # Without gva_mi.core.console, because its package tqdm may be missing.
        sys.stdout.write(f"{component}\n")
        sys.stdout.flush()
    sys.exit(0 if fine else 1)


def examine() -> Iterator[Component]:
    """Examine everything that the program can use, essential components first."""
    yield Component("python", platform.python_version(), sys.version_info >= (3, 11))
    yield Component("system", f"{platform.platform()}, {os.cpu_count()} cores")
    extras = {"torch": ""} | {x: extra for extra, modules in PACKAGES.items() for x in modules}
    together = _start_importing(*extras)  # beside the next lines
    yield from _dr_jit()
    together.communicate()
    for module, extra in extras.items():
        if together.returncode == 0:
            yield Component(module, _version(module))
        else:
            yield _package(module, extra)
    for module, (commands, extra) in OPTIONAL.items():
        wanted = f"none; {commands} would need it: pip install 'gva_mi[{extra}]'"
        there = importlib.util.find_spec(module) is not None  # importing may take seconds
        yield Component(module, _version(module) if there else wanted)
    yield from _weights()


def _dr_jit() -> Iterator[Component]:
    """Run a kernel that aborts with an old libLLVM, and read the vector width from its code."""
    if llvm.problem:
        yield Component("libLLVM", llvm.problem, False)
        return
    import drjit as dr
    from drjit.llvm import Float

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        smaller = dr.minimum(dr.opaque(Float, 1, 64), 0.5)
        dr.eval(smaller)
        code = "".join(kernel["ir"].getvalue() for kernel in dr.kernel_history() if "ir" in kernel)
    lanes = re.search(r"<(\d+) x float>", code)
    found = ".".join(map(str, dr.detail.llvm_version()))
    yield Component("libLLVM", f"{found} at {os.environ.get(llvm.PATH, 'the default path')}")
    width = f", {lanes.group(1)} float32 lanes" if lanes else ""
    says = f"{dr.__version__}, {dr.thread_count()} threads{width}"
    yield Component("drjit", says, bool(dr.all(smaller == 0.5)))


def _version(module: str) -> str:
    return metadata.version(_distributions().get(module, [module])[0])


@functools.cache  # reads the list of files of every package
def _distributions() -> Mapping[str, list[str]]:
    return metadata.packages_distributions()


def _start_importing(*modules: str) -> subprocess.Popen[str]:
    """Import packages in a process of its own, because a broken wheel may fail in any way."""
    trial = f"import gva_mi, {', '.join(modules)}"
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, "-c", trial], stdout=pipe, stderr=pipe, text=True)


def _package(module: str, extra: str) -> Component:
    """Import one package, and say what is wrong with it."""
    trial = _start_importing(module)
    _, complaint = trial.communicate()
    if trial.returncode == 0:
        return Component(module, _version(module))
    last = (complaint.strip().splitlines() or [f"exit code {trial.returncode}"])[-1]
    if "ModuleNotFound" in last:
        last += f"; pip install 'gva_mi[{extra}]'"
    if "libGL" in last or "libX11" in last:
        last += "; apt-get install libgl1 libx11-6"
    return Component(module, last, False)


def _weights() -> Iterator[Component]:
    """Report network weights. All are optional: a line names what replaces missing weights."""
    from gva_mi.fit.perceptual import find_weights

    weights = find_weights()
    vgg = "none; the perceptual loss uses the random network rand_vgg"
    if weights.vgg16:
        vgg = f"{weights.vgg16}; a fit uses it only with gva-mi fit --vgg16 FILE"
    yield Component("VGG16", vgg)
    lpips = "on VGG16" if weights.of_lpips else "none; rand_vgg is reported instead"
    yield Component("LPIPS", lpips)
