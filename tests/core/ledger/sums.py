"""The stages of the ledger, and a hash of what each computes: a small subject on its whole way.

    python tests/core/ledger/sums.py         # print this CPU's hashes
    python tests/core/ledger/sums.py --add   # and write them into ledger.json

One process does all of it, so that a CPU which QEMU emulates can do it, too (user mode does not
emulate a child process):

    NPY_DISABLE_CPU_FEATURES=X86_V3 qemu-x86_64 -cpu Haswell .venv/bin/python \\
        tests/core/ledger/sums.py --add --cpu "Intel Haswell, emulated by QEMU 7.2"

The variable keeps numpy from its AVX2 code, whose sorting goes wrong in QEMU 7.2. On a CPU it
changes no hash.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from importlib import metadata
from io import StringIO
from pathlib import Path

from gva_mi.__main__ import main
from gva_mi.core.cpu import pin_cpu_features

pin_cpu_features()

import numpy as np  # noqa: E402  after the libraries are pinned
from PIL import Image  # noqa: E402

LEDGER = Path(__file__).with_name("ledger.json")
CPUINFO = Path("/proc/cpuinfo")
OF_BITS = ("drjit", "mitsuba", "numpy", "scipy", "torch")  # whose versions decide about bits
SUBJECT = {"seed": 2, "frames": 3, "size": 64, "novel_poses": 1, "novel_views": 0}
VIDEO = {"seed": 2, "frames": 12, "size": 200, "novel_poses": 0, "novel_views": 0}


def stages() -> Iterator[tuple[str, str]]:
    """Yield name and hash of each stage, in the order in which one needs the other."""
    from gva_mi.body.smplx import load_body
    from gva_mi.synthetic import SynthOptions, make_subject

    with tempfile.TemporaryDirectory() as folder:
        subject, run = Path(folder) / "subject", Path(folder) / "run"
        make_subject(subject, SynthOptions(**SUBJECT), load_body())
        yield "poses of synth", _of_files(subject.glob("**/*.npz"))
        yield "pictures of synth", _of_files(subject.glob("**/frames/*.png"))
        yield "masks and normals of synth", _of_files(subject.glob("[mn]*s/*.png"))
        yield from splatting()
        yield from mesh_normals()
        _command("refine", subject, "--passes", "1", "--size", "64")
        yield "refined poses", _of_files([subject / "poses_refined.npz"])
        _command("fit", subject, "--out", run, "--steps", "10", "--avatar.seed.count", "800")
        yield "avatar", _of_files([run / "avatar.npz", run / "poses.npz"])
        renders, novel = Path(folder) / "renders", subject / "truth/novel_pose"
        seen = "--poses", novel / "poses.npz", "--cameras", novel / "cameras.npz"
        _command("render", run, *seen, "--out", renders)
        yield "render", _of_files(renders.glob("*.png"))
        yield from videos(Path(folder))


def videos(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield the hashes of the pictures of whole videos, and of the refined poses of one.

    They guard single pixels: each video casts some eight million rays. A "faster ray tracer with
    the same bits" once changed a ray in a million, hence one pixel of 64 frames, and with it every
    figure of the demo. Three frames of 64 pixels did not show it; the room here does.
    """
    from gva_mi.body.smplx import load_body
    from gva_mi.synthetic import SynthOptions, make_subject

    for scene in ("room", "white"):
        make_subject(folder / scene, SynthOptions(**VIDEO, scene=scene), load_body())
        yield f"pictures of a video, {scene}", _of_files((folder / scene).glob("[fmn]*s/*.png"))
    _command("refine", folder / "white", "--passes", "1", "--size", "64")
    yield "refined poses of a video", _of_files([folder / "white/poses_refined.npz"])


def _command(*arguments: object) -> None:
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        main([str(argument) for argument in arguments])


def _of_files(paths: Iterable[Path]) -> str:
    """Hash the numbers in files: their bytes also depend on the versions of Python and zlib."""
    found = [number for path in sorted(paths) for number in _numbers(path)]
    if not found:
        raise FileNotFoundError("a stage wrote no files")
    return _hash(found)


def _numbers(path: Path) -> Iterator[np.ndarray]:
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            yield from (x for name in sorted(arrays) if (x := arrays[name]).dtype.kind in "biuf")
    else:
        with Image.open(path) as picture:
            yield np.asarray(picture)


def _hash(arrays: Iterable[np.ndarray]) -> str:
    digest = hashlib.sha256()
    for x in arrays:
        digest.update(f"{x.dtype}{x.shape}".encode() + x.tobytes())
    return digest.hexdigest()[:16]


def of_tensors(tensors: Iterable) -> str:
    """Hash tensors."""
    return _hash(x.detach().numpy() for x in tensors)


def splatting() -> Iterator[tuple[str, str]]:
    """Yield the hashes of an image and of its adjoint, in both precisions."""
    import torch

    from gva_mi.splat import render
    from gva_mi.splat.scene import person_scene

    for dtype in (torch.float32, torch.float64):
        scene = person_scene(np.random.default_rng(0), 500, 64).to(dtype)
        inputs = [x.requires_grad_() for x in scene.inputs().values()]
        color = render(scene.gaussians, scene.camera, scene.options, scene.background).color
        weights = torch.linspace(-1, 1, color.numel(), dtype=dtype).reshape(color.shape)
        gradients = torch.autograd.grad((color * weights).sum(), inputs)
        name = f"splatting, {str(dtype).removeprefix('torch.')}"
        yield name, of_tensors([color])
        yield f"{name}, adjoint", of_tensors(gradients)


def mesh_normals() -> Iterator[tuple[str, str]]:
    """Yield the hashes of an image of a mesh and of its adjoint."""
    import torch

    from gva_mi.body.pose import Pose, Shape
    from gva_mi.body.smplx import load_body
    from gva_mi.mesh.mesh_scene import MeshScene
    from gva_mi.splat import Camera, look_at

    body = load_body()
    posed = body(Pose.rest(1), Shape(torch.zeros(10))).vertices[0]
    vertices = posed.detach().contiguous().requires_grad_()
    K = [[90.0, 0, 32], [0, 90, 32], [0, 0, 1]]
    camera = Camera.from_matrices(K, look_at((0.3, 0.4, 3.0), (0, -0.1, 0)), 64, 64)
    image = MeshScene(body.faces, body.v_template).render(vertices, camera)
    weights = torch.linspace(-1, 1, image.numel()).reshape(image.shape)
    (gradient,) = torch.autograd.grad((image * weights).sum(), [vertices])
    yield "mesh normals and silhouette", of_tensors([image])
    yield "mesh normals and silhouette, adjoint", of_tensors([gradient])


def this_cpu() -> str:
    """Return vendor, family, model and name of this CPU, and its widest vectors."""
    lines = (line.split(":", 1) for line in CPUINFO.read_text().splitlines() if ":" in line)
    first: dict[str, str] = {}
    for key, value in lines:
        first.setdefault(key.strip(), value.strip())
    widest = next((w for w in ("avx512f", "avx2") if w in first["flags"].split()), "no avx2")
    numbers = f"family {first['cpu family']} model {first['model']}"
    return f"{first['vendor_id']} {numbers} ({first['model name']}), {widest}"


def versions() -> dict[str, str]:
    """Return the versions of the libraries that decide about bits."""
    return {name: metadata.version(name) for name in OF_BITS}


def add(cpu: str, found: dict[str, str]) -> None:
    """Write a CPU's line. If it has other hashes of its old stages, the program has changed.

    Then the other CPUs' lines go. Stages that are new to the ledger change no other line.
    """
    ledger = json.loads(LEDGER.read_text()) if LEDGER.exists() else {}
    lines = ledger.get("cpus", {}) if ledger.get("versions") == versions() else {}
    if not lines.get(cpu, {}).items() <= found.items():
        lines = {}
    lines[cpu] = found
    LEDGER.write_text(json.dumps({"versions": versions(), "cpus": lines}, indent=1) + "\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--add", action="store_true", help="write the line of this CPU")
    parser.add_argument("--cpu", help="name of the line; without it this CPU's own name")
    options = parser.parse_args()
    cpu, found = options.cpu or this_cpu(), dict(stages())
    json.dump({"cpu": cpu, "versions": versions(), "stages": found}, sys.stdout, indent=1)
    if options.add:
        add(cpu, found)
