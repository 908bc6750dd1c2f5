"""Cost per frame of long videos: 2,000 frames of 1080p must fit into 4 GiB.

    python -m pytest -m slow tests/data/test_scale.py -s

prints the figures. Footage is drawn. What is read: somebody made of an ellipse before a pattern, as
a film, with masks as one .npy. What is refined and fitted: the puppet, in one picture that serves
under many names.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.core.spill_cache import KEPT
from gva_mi.data.cameras import save_cameras
from gva_mi.data.film import write_film
from gva_mi.data.pictures import write_image
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera, look_at

WIDTH, HEIGHT, FEW, MANY, LONG = 1920, 1080, 30, 90, 2000
FEW_SOLVED, MANY_SOLVED = 125, 250  # refined and fitted: both are cut into clips
MOST = 4 << 30  # bytes
WORKERS = 2

# A worker's peak is asked for while it runs: what the system keeps of one that has ended counts
# the memory of the process that it was started from.
MEASURED = """
import re, resource, sys, threading, time
from pathlib import Path

def peak(process):
    try:
        status = Path(f"/proc/{{process}}/status").read_text()
        return 1024 * int(re.search(r"VmHWM:\\s+(\\d+) kB", status)[1])
    except (OSError, TypeError):  # it has ended
        return 0

def watch():
    global largest
    while True:
        for task in Path("/proc/self/task").glob("*/children"):
            try:
                largest = max([largest, *map(peak, task.read_text().split())])
            except OSError:
                pass
        time.sleep(0.1)

if __name__ == "__main__":
    largest = 0
    threading.Thread(target=watch, daemon=True).start()
    sys.argv = ["gva-mi", *sys.argv[1:]]
    try:
        {work}
    except SystemExit as stop:
        assert stop.code in (0, 1, None), stop.code
    kinds = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    used = [getattr(resource.getrusage(k), n) for k in kinds for n in ("ru_utime", "ru_stime")]
    print("MEASURED", peak("self"), sum(used), largest)
"""
COMMAND = "from gva_mi.__main__ import main; main()"
# What stays in memory before frames go to disk grows with the first 400 frames and then no more, so
# both lengths are measured with little of it, and the rest is added.
LITTLE_KEPT = 1 << 24  # bytes
CACHES = 2  # of one command
SPILLS = (
    "from gva_mi.core.spill_cache import SpillCache; "
    f"SpillCache.__init__.__defaults__ = ({LITTLE_KEPT},); {COMMAND}"
)
OPEN = (
    "from pathlib import Path; from gva_mi.data.video import load_video; "
    "assert all(f.mask.max() == 1 for f in load_video(Path(sys.argv[1])).frames())"
)
WATCH = (
    "from pathlib import Path; from gva_mi.data.film import Film; "
    "assert all(image.max() > 100 for image in Film(Path(sys.argv[1]), kept=0))"
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc to ask for memory"),
]


def draw(folder, frames):
    """A film, a stack of masks, and poses of somebody who walks to and fro."""
    folder.mkdir()
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    pattern = (90 + 40 * np.sin(x / 37) * np.cos(y / 53)).astype(np.uint8)
    stack = np.lib.format.open_memmap(folder / "masks.npy", "w+", np.uint8, (frames, HEIGHT, WIDTH))

    def pictures():
        for k in range(frames):
            stack[k] = ((x - 960 - 200 * np.sin(k / 50)) / 160) ** 2 + ((y - 800) / 250) ** 2 < 1
            image = np.stack([pattern, pattern, np.full_like(pattern, 100)], axis=-1)
            image[stack[k] > 0] = (200, 150, 3 * k % 255)
            yield image

    write_film(folder / "video.mp4", pictures(), way="playable")
    stack.flush()
    k = np.arange(frames)
    transl = np.stack([0.4 * np.sin(k / 50), 0.2 + 0 * k, 3.5 + 0 * k], axis=1)
    root = np.tile([np.pi, 0, 0], (frames, 1))
    np.savez(
        folder / "poses.npz", global_orient=root, body_pose=np.zeros((frames, 63)), transl=transl,
        betas=np.zeros((1, 10)), focal=np.array(1800.0),
    )  # fmt: skip


def measured(work, *arguments):
    """Peak memory in bytes, CPU seconds, and the largest worker's peak, of a program of its own."""
    program = [sys.executable, "-c", MEASURED.format(work=work), *map(str, arguments)]
    done = subprocess.run(program, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return np.array([float(figure) for figure in done.stdout.rsplit("MEASURED", 1)[1].split()])


def draw_puppet(folder, frames, body):
    """A subject's folder of the puppet at rest before a plain wall, with noisy poses."""
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


def steps(folder, frames):
    draw(folder, frames)
    footage = ["--frames", folder / "video.mp4", "--masks", folder / "masks.npy"]
    given = ["parameters", folder / "poses.npz", folder / "subject", "--body", "puppet", *footage]
    return {
        "prepare": measured(COMMAND, "prepare", *given),
        "check": measured(COMMAND, "check", folder / "subject"),
        "opening": measured(OPEN, folder / "subject"),
        "a film": measured(WATCH, folder / "video.mp4"),
    }


def solved(folder, frames, body):
    draw_puppet(folder, frames, body)
    few_steps = ["--steps", 2, "--avatar.seed.count", 2000]
    return {
        "refine": measured(SPILLS, "refine", folder, "--passes", 1, "--workers", WORKERS),
        "fit": measured(SPILLS, "fit", folder, "--out", folder / "run", *few_steps),
    }


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


def test_memory_and_time_per_frame_stay_constant(tmp_path):
    few, many = steps(tmp_path / "few", FEW), steps(tmp_path / "many", MANY)
    require_flat(few, many, FEW, MANY)


def test_refine_and_fit_need_constant_time_per_frame(tmp_path, built_in_body):
    few = solved(tmp_path / "few", FEW_SOLVED, built_in_body)
    many = solved(tmp_path / "many", MANY_SOLVED, built_in_body)
    require_flat(few, many, FEW_SOLVED, MANY_SOLVED, CACHES * (KEPT - LITTLE_KEPT))
