"""Long videos: what a frame more costs. 2,000 frames of 1080p must fit into 4 GiB.

    python -m pytest -m slow tests/data/test_scale.py -s

prints the figures. Footage is drawn: somebody made of an ellipse before a pattern, as a film, with
masks as one .npy, which used to be read whole.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gva_mi.data.pictures import write_movie

WIDTH, HEIGHT, FEW, MANY, LONG = 1920, 1080, 30, 90, 2000
MOST = 4 << 30  # bytes

MEASURED = """
import re, resource, sys
sys.argv = ["gva-mi", *sys.argv[1:]]
try:
    {work}
except SystemExit as stop:
    assert stop.code in (0, 1, None), stop.code
used = resource.getrusage(resource.RUSAGE_SELF)
peak = re.search(r"VmHWM:\\s+(\\d+) kB", open("/proc/self/status").read())[1]
print("MEASURED", 1024 * int(peak), used.ru_utime + used.ru_stime)
"""
COMMAND = "from gva_mi.__main__ import main; main()"
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

    write_movie(folder / "video.mp4", pictures(), lossless=False)
    stack.flush()
    k = np.arange(frames)
    transl = np.stack([0.4 * np.sin(k / 50), 0.2 + 0 * k, 3.5 + 0 * k], axis=1)
    root = np.tile([np.pi, 0, 0], (frames, 1))
    np.savez(
        folder / "poses.npz", global_orient=root, body_pose=np.zeros((frames, 63)), transl=transl,
        betas=np.zeros((1, 10)), focal=np.array(1800.0),
    )  # fmt: skip


def measured(work, *arguments):
    """Peak memory in bytes and CPU seconds of a program of its own."""
    program = [sys.executable, "-c", MEASURED.format(work=work), *map(str, arguments)]
    done = subprocess.run(program, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    peak, seconds = done.stdout.rsplit("MEASURED", 1)[1].split()
    return np.array([float(peak), float(seconds)])


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


def test_a_frame_more_costs_no_memory_and_the_same_time(tmp_path):
    few, many = steps(tmp_path / "few", FEW), steps(tmp_path / "many", MANY)
    for name, found in many.items():
        peak, (bytes_more, seconds_more) = found[0], (found - few[name]) / (MANY - FEW)
        long = peak + max(0.0, bytes_more) * (LONG - MANY)
        sys.stdout.write(
            f"{name}: {1e3 * seconds_more:.0f} ms of CPU and {bytes_more / 1e6:.2f} MB a frame; "
            f"{peak / 2**30:.2f} GiB at {MANY} frames, {long / 2**30:.2f} GiB at {LONG}\n"
        )
        assert long < MOST, name
        # A start-up that both have makes the first frames dearer, never the later ones.
        assert seconds_more < 1.5 * few[name][1] / FEW, name
