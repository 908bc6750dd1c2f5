"""What a user's type checker sees of the package: types, and no ``Any`` where a type is known."""

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path
from types import FunctionType

import gva_mi.app
import gva_mi.splat

ROOT = Path(__file__).parents[1]
# Right lines, and wrong ones: each comment must be needed, and name the error.
PROGRAM = """
from typing import assert_type

import torch
from drjit.llvm.ad import TensorXf
from gva_mi.app import evaluate, fit, prepare, refine, render as draw_run, track
from gva_mi.body.pose import Pose
from gva_mi.evaluate.measure import Metrics
from gva_mi.splat import Camera, Gaussians, Image, Screen, look_at, rasterization, render
from gva_mi.splat.drjit_render import render as render_native

camera = Camera(8.0, 8.0, 4.0, 4.0, look_at((0, 0, 2), (0, 0, 0)), 8, 8)
camera = Camera.from_matrices([[8, 0, 4], [0, 8, 4], [0, 0, 1]], torch.eye(4), 8, 8)
x, y = torch.zeros(1, 3), TensorXf(0.0)
ours, native = Gaussians(x, x, x, x, x), Gaussians(y, y, y, y, y)
assert_type(render(ours, camera, screen=Screen()), Image[torch.Tensor])
assert_type(render_native(native, camera).alpha, TensorXf)
colors, alphas, meta = rasterization(x, None, None, x, x, x, x, 8, 8, covars=x)
assert_type((colors, alphas), tuple[torch.Tensor, torch.Tensor])
assert_type((meta["means2d"], meta["width"]), tuple[torch.Tensor, int])
assert_type(evaluate("run", "subject"), Metrics)
assert_type(track("run", "subject"), Pose)

import gva_mi.splat.nothing  # type: ignore[import-not-found]
from gva_mi.splat import raster  # type: ignore[attr-defined]
number: int = rasterization  # type: ignore[assignment]
render(native, camera)  # type: ignore[arg-type]
render_native(ours, camera)  # type: ignore[type-var]
rasterization(x, x, x, x, x, x, x, 8, 8, render_mode="rgb")  # type: ignore[arg-type]
Camera(8.0, 8.0, 4.0, 4.0, camera.T_camera_world, 8, 8, "lens")  # type: ignore[arg-type]
prepare("video.mp4")  # type: ignore[call-arg]
refine("subject", poses=3)  # type: ignore[call-arg]
fit(1, "run")  # type: ignore[arg-type]
draw_run("run", "out", video="yes")  # type: ignore[arg-type]
"""
# Of other libraries: arrays of any shape and number, and Dr.Jit's generic array.
THEIR_ANY = re.compile(r"(tuple|dtype|ArrayBase)\[Any(, (Any|\.\.\.))*\]")
METHODS = (FunctionType, property, staticmethod, classmethod)


def public():
    """Names of all public functions, classes and methods of the two packages."""
    for module in (gva_mi.splat, gva_mi.app):
        for name in module.__all__:
            value, where = getattr(module, name), f"{module.__name__}.{name}"
            yield where
            if inspect.isclass(value):
                methods = (x for x, y in vars(value).items() if isinstance(y, METHODS))
                yield from (f"{where}.{x}" for x in methods if not x.startswith("_"))


def test_public_signatures_have_types(tmp_path):
    """By mypy, which strips the bodies of a package's functions."""
    names = list(public())
    (tmp_path / "user.py").write_text(PROGRAM)
    shown = "\n".join(f"reveal_type({name})" for name in names)
    (tmp_path / "names.py").write_text(f"import gva_mi.app\nimport gva_mi.splat\n{shown}\n")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent",
         "--cache-dir", ROOT / ".mypy_cache", "user.py", "names.py"],
        cwd=tmp_path, env=os.environ | {"MYPYPATH": str(ROOT)}, capture_output=True, text=True,
    )  # fmt: skip
    lines = done.stdout.splitlines()
    types = [line.partition("Revealed type is ")[2] for line in lines if "Revealed" in line]
    assert [line for line in lines if "error:" in line] == [], done.stderr
    assert len(types) == len(names) > 40
    unknown = [
        (name, found)
        for name, found in zip(names, types, strict=True)
        if re.search(r"\bAny\b", THEIR_ANY.sub("", found))
    ]
    assert unknown == []
