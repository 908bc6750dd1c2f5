"""Cost per frame of long videos: 2,000 frames of 1080p must fit into 4 GiB.

    python -m pytest -m slow tests/subject/test_scale.py -s

prints the figures. The subject is the built-in body, in one picture that serves under many names.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.core.spill_cache import BYTES_IN_MEMORY
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera, look_at
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.pictures import write_image

WIDTH, HEIGHT, LONG = 1920, 1080, 2000
FEW_SOLVED, MANY_SOLVED = 125, 250  # refined and fitted: both are cut into clips
MOST = 4 << 30  # bytes
WORKERS = 2

MEASURED = """
import resource, sys

if __name__ == "__main__":
    sys.argv = ["gva-mi", *sys.argv[1:]]
    try:
        {work}
    except SystemExit as stop:
        assert stop.code in (0, 1, None), stop.code
    here, workers = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    seconds = here.ru_utime + here.ru_stime + workers.ru_utime + workers.ru_stime
    print("MEASURED", 1024 * here.ru_maxrss, seconds, 1024 * workers.ru_maxrss)
"""
COMMAND = "from gva_mi.__main__ import main; main()"
# What stays in memory before frames go to disk grows with the first 400 frames and then no more, so
# both lengths are measured with little of it, and the rest is added.
LITTLE_KEPT = 1 << 24  # bytes
CACHES = 2  # of one command
SPILLS = (
    f"from gva_mi.core import spill_cache; spill_cache.BYTES_IN_MEMORY = {LITTLE_KEPT}; {COMMAND}"
)
OPEN = (
    "from pathlib import Path; from gva_mi.subject.video import load_video; "
    "assert all(f.mask.max() == 1 for f in load_video(Path(sys.argv[1])).frames())"
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc to ask for memory"),
]


def measured(work, *arguments):
    """Peak memory in bytes, CPU seconds, and the largest worker's peak, of a program of its own."""
    program = [sys.executable, "-c", MEASURED.format(work=work), *map(str, arguments)]
    done = subprocess.run(program, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return np.array([float(figure) for figure in done.stdout.rsplit("MEASURED", 1)[1].split()])


def draw_person(folder, frames, body):
    """A subject's folder of the built-in body at rest before a plain wall, with noisy poses."""
    centre = (body.v_template.amin(0) + body.v_template.amax(0)).numpy() / 2
    view = look_at(centre + (0, 0, 3.4), centre)
    camera = Camera(1800, 1800, WIDTH / 2, HEIGHT / 2, view, WIDTH, HEIGHT)
    with torch.no_grad():
        seen = MeshScene(body.faces, body.v_template).render(body.v_template, camera).numpy()
    inside = seen[..., 3:] > 0.5
    write_image(folder / "frames/000000.png", np.where(inside, (seen[..., :3] + 1) / 2, 0.4))
    write_image(folder / "masks/000000.png", inside[..., 0] * 1.0)
    for k in range(1, frames):
        for kind in ("frames", "masks"):
            os.link(folder / kind / "000000.png", folder / kind / f"{k:06d}.png")
    noise = torch.randn((frames, 55, 3), generator=torch.Generator().manual_seed(0))
    pose = Pose(0.03 * noise, torch.zeros(frames, 3), torch.zeros(frames, 10))
    save_poses(folder / "poses.npz", pose, Shape(torch.zeros(10)), stage=1)
    save_cameras(folder / "cameras.npz", [camera])


def solved(folder, frames, body):
    draw_person(folder, frames, body)
    few_steps = ["--steps", 2, "--avatar.seed.count", 2000]
    return {"check": measured(COMMAND, "check", folder), "opening": measured(OPEN, folder),
        "refine": measured(SPILLS, "refine", folder, "--passes", 1, "--workers", WORKERS),
        "fit": measured(SPILLS, "fit", folder, "--out", folder / "run", *few_steps)}  # fmt: skip


def require_flat(few, many, fewer, more, kept=0):
    """Check memory and time of what was measured at two lengths, and say them.

    Args:
        few, many: by the name of a step, what :func:`measured` returns.
        fewer, more: frames.
        kept: bytes that a longer video keeps in memory beside it.
    """
    for name, found in many.items():
        bytes_more, seconds_more, of_worker = (found - few[name]) / (more - fewer)
        longer = [max(0.0, slope) * (LONG - more) for slope in (bytes_more, of_worker)]
        long, long_worker = found[0] + longer[0] + kept, found[2] + longer[1]
        workers = f", a worker {found[2] / 2**30:.2f} GiB" if found[2] else ""
        sys.stdout.write(
            f"{name}: {1e3 * seconds_more:.0f} ms of CPU and {bytes_more / 1e6:.2f} MB a frame; "
            f"{few[name][0] / 2**30:.2f} GiB at {fewer} frames, {found[0] / 2**30:.2f} GiB at "
            f"{more}{workers}, {long / 2**30:.2f} GiB at {LONG}\n"
        )
        assert long + WORKERS * long_worker < MOST, name
        # A start-up that both have makes the first frames dearer, never the later ones.
        assert seconds_more < 1.5 * few[name][1] / fewer, name


def test_memory_and_time_per_frame_stay_constant(tmp_path, built_in_body):
    few = solved(tmp_path / "few", FEW_SOLVED, built_in_body)
    many = solved(tmp_path / "many", MANY_SOLVED, built_in_body)
    require_flat(few, many, FEW_SOLVED, MANY_SOLVED, CACHES * (BYTES_IN_MEMORY - LITTLE_KEPT))
