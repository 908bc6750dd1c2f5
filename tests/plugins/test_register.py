"""``register`` works repeatedly and for every differentiable variant, and refuses others."""

import subprocess
import sys

import mitsuba as mi
import pytest

PROGRAM = """
import sys

import gva_mi_plugins
import mitsuba as mi
import numpy as np


def picture():
    film = {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "integrator": {"type": "mesh_normals"},
        "sensor": {"type": "perspective", "film": film},
        "shape": {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 0, 6])},
    }
    return np.array(mi.render(mi.load_dict(scene), spp=1))


images, modules = [], set()
for variant in ("llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_rgb"):
    mi.set_variant(variant)
    gva_mi_plugins.register()
    gva_mi_plugins.register()
    images.append(picture())
    modules.add(sys.modules["gva_mi_plugins.mesh_normals.integrator"])
assert images[0][..., 3].max() == 1
assert all(np.array_equal(images[0], image) for image in images[1:])
assert len(modules) == 1, "a program may hold a plugin's module"
mi.load_dict({"type": "gaussian_splat"})  # for llvm_ad_rgb again
mi.set_variant("scalar_rgb")
try:
    gva_mi_plugins.register()
except RuntimeError as error:
    print(error)
"""


def test_a_change_of_variant():
    """In a process of its own, because a variant holds for the whole process."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "needs a differentiable variant, and mi.variant() is scalar_rgb" in done.stdout


@pytest.mark.parametrize("outer", [{"type": "aov", "aovs": "d:depth"}, {"type": "moment"}])
@pytest.mark.parametrize("name", ["mesh_normals", "gaussian_splat"])
def test_an_integrator_of_rays_cannot_hold_one_of_images(scenes, outer, name):
    """``mi.render`` reports the refusal as the cause of its own error."""
    nested = mi.load_dict(outer | {"nested": {"type": name}})
    tensor = lambda *rows: mi.TensorXf([list(row) for row in rows])
    splat = {"centers": tensor((0, 0, 0)), "scales": tensor((1, 1, 1)), "opacities": tensor((1,))}
    splat |= {"quaternions": tensor((0, 0, 0, 1)), "sh_coeffs": tensor((1, 1, 1))}
    shapes = {"m": {"type": "cube"}, "s": {"type": "ellipsoids"} | splat}
    scene = mi.load_dict({"type": "scene"} | shapes)
    with pytest.raises(RuntimeError) as caught:
        mi.render(scene, sensor=scenes.camera(8), integrator=nested, spp=1)
    error = caught.value
    while error.__cause__ is not None:
        error = error.__cause__
    assert isinstance(error, ValueError) and f"{name}: draws whole images" in str(error)
