"""OpenSplat's CPU rasterizer, timed beside ours where the user has its sources.

OpenSplat is AGPL-3: nothing of it is here. The user names a folder of its sources; four of its
files are compiled on the user's machine together with ``opensplat_binding.cpp``, which is ours and
calls its public functions, those that its training calls on a CPU. torch keeps what was compiled.

Its pixels have their centres at whole numbers, and its projection takes half a pixel off for it.
Its projection is torch's operations, its compositing one loop in one thread. Our binding hands it
the depths side by side: it sorts by them as if they were, and without that draws in a wrong order.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType

import torch
from torch import Tensor
from torch.nn.functional import normalize

from gva_mi.errors import InputError
from gva_mi.splat.scene import Scene

HOME = "https://github.com/pierotofy/OpenSplat"
BINDING = Path(__file__).with_name("opensplat_binding.cpp")
SOURCES = (
    "project_gaussians.cpp",
    "rasterize_gaussians.cpp",
    "spherical_harmonics.cpp",
    "rasterizer/gsplat-cpu/gsplat_cpu.cpp",
)


def load(folder: Path | None) -> Callable[[Scene], Callable[[], Tensor]]:
    """Compile OpenSplat's sources, or find them compiled; returns :func:`drawing` by them.

    Raises:
        InputError: the sources, a compiler or ninja are missing, or they do not compile.
    """
    if folder is None:
        raise InputError(
            f"bench: --against opensplat needs --opensplat-sources DIR, a folder of its sources "
            f"(git clone {HOME})"
        )
    missing = next((name for name in SOURCES if not (folder / name).is_file()), None)
    if missing is not None:
        raise InputError(
            f"bench: --opensplat-sources {folder} holds no {missing}: expected the folder of "
            f"OpenSplat's sources ({HOME})"
        )
    files = [*(folder / name for name in SOURCES), BINDING]
    module = compiled("gva_mi_opensplat", files, [folder, folder / "rasterizer"])
    return lambda scene: drawing(module, scene)


def compiled(name: str, files: Sequence[Path], folders: Sequence[Path]) -> ModuleType:
    """An extension of torch from C++ files and the folders of their headers.

    Raises:
        InputError: there is no compiler or no ninja, or the files do not compile.
    """
    from torch.utils import cpp_extension  # it takes a while, and looks for a CUDA

    compiler = cpp_extension.get_cxx_compiler()
    if shutil.which(compiler) is None:
        raise InputError(
            f"bench: --against opensplat needs a C++ compiler, and {compiler} is not there: "
            f"install g++, or name one in the environment as CXX"
        )
    if not cpp_extension.is_ninja_available():
        raise InputError("bench: --against opensplat needs ninja to compile: pip install ninja")
    sources, headers = ([str(path.resolve()) for path in paths] for paths in (files, folders))
    try:
        return cpp_extension.load(name, sources, extra_cflags=["-O3"], extra_include_paths=headers)
    except (RuntimeError, ImportError, OSError) as error:
        lines = str(error).splitlines()
        told = next((line for line in lines if "error:" in line), lines[0] if lines else "")
        raise InputError(
            f"bench: OpenSplat's sources do not compile here: {told.strip()}"
        ) from error


def drawing(module: ModuleType, scene: Scene) -> Callable[[], Tensor]:
    """Draws the colour (H, W, 3), differentiable by the Gaussians but for directions' gradient.

    Args:
        module: of :func:`compiled`.
        scene: of float32, with spherical harmonics and a pinhole camera.
    """
    g, camera = scene.gaussians, scene.camera
    T, position = torch.tensor(camera.T_camera_world), torch.tensor(camera.position)
    with torch.no_grad():
        depths = g.means.double() @ T[2, :3] + T[2, 3]
    near, far = 0.5 * float(depths.min()), 2 * float(depths.max())  # float32 tells depths apart
    width, height = camera.width, camera.height
    to_clip = torch.tensor(
        [
            [2 * camera.fx / width, 0, 2 * camera.cx / width - 1, 0],
            [0, 2 * camera.fy / height, 2 * camera.cy / height - 1, 0],
            [0, 0, (far + near) / (far - near), -far * near / (far - near)],
            [0, 0, 1, 0],
        ],
        dtype=torch.float64,
    )
    view, projection = T.float(), (to_clip @ T).float()
    lens = (camera.fx, camera.fy, camera.cx, camera.cy, width, height)

    def draw() -> Tensor:
        toward = normalize(g.means.detach() - position.float(), dim=-1)
        opacities, behind = g.opacities[:, None], scene.background.detach()
        bodies = (g.means, g.quats, g.scales, opacities, g.sh)
        return module.render(*bodies, toward, view, projection, behind, *lens)

    return draw
