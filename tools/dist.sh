#!/bin/sh
# Build the wheel and the sdist into out/dist, and try the wheel in an empty environment: `make dist`.
set -eu
python=${PYTHON:-python3}
out=$PWD/out/dist
constraints=$PWD/constraints.txt
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
unset PYTHONPATH PYTHONHOME
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_QUIET=1 MPLBACKEND=Agg

rm -rf "$out" build
"$python" -m venv "$tmp/build"
"$tmp/build/bin/pip" install build
"$tmp/build/bin/python" -m build --sdist --wheel --outdir "$out" . >"$tmp/log"
rm -rf build ./*.egg-info
"$tmp/build/bin/pip" wheel --no-deps --wheel-dir "$tmp/of_sdist" "$out"/*.tar.gz
"$tmp/build/bin/python" - "$out"/*.whl "$tmp"/of_sdist/*.whl <<'END'
import sys, zipfile

of_tree, of_sdist = (
    {info.filename: info.CRC for info in zipfile.ZipFile(path).infolist()
     if not info.filename.endswith("/RECORD")}
    for path in sys.argv[1:]
)
differ = sorted(k for k in of_tree.keys() | of_sdist.keys() if of_tree.get(k) != of_sdist.get(k))
if differ:
    sys.exit(f"the wheels of the checkout and of the sdist differ in {', '.join(differ)}")
print(f"the sdist builds the same wheel: {len(of_tree)} files")
END

"$python" -m venv "$tmp/empty"
pip="$tmp/empty/bin/pip"
"$pip" install --constraint "$constraints" torch
"$pip" install --constraint "$constraints" "$(echo "$out"/*.whl)[avatar]"
cd "$tmp"
"$tmp/empty/bin/gva-mi" --help >/dev/null
"$tmp/empty/bin/gva-mi" doctor
"$tmp/empty/bin/gva-mi" synth subject --frames 2 --size 32
"$tmp/empty/bin/python" - <<'END'
from pathlib import Path

import gva_mi
import gva_mi_plugins
import mitsuba as mi
import torch
from gva_mi.splat import render
from gva_mi.splat.scene import random_scene

assert Path(gva_mi.__file__).is_relative_to(Path.cwd()), gva_mi.__file__
scene = random_scene(torch.Generator().manual_seed(0), gaussians=10).to(torch.float32)
means = scene.gaussians.means.requires_grad_()
render(scene.gaussians, scene.camera).color.sum().backward()
assert means.grad.abs().sum() > 0
mi.set_variant("llvm_ad_rgb")
gva_mi_plugins.register()
for name in ("gaussian_splat", "mesh_normals"):
    mi.load_dict({"type": name})
print("import, command, kernels with gradients and plugins work in an empty environment")
END
ls -l "$out"
