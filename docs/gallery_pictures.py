"""Pictures of the gallery that several commands make: what a motion and an export look like.

    python docs/gallery_pictures.py RUN OUT

RUN is the folder of a finished fit; ``motions.png`` and ``exports.png`` are written into OUT.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from gva_mi.data.pictures import read_image

SIZE = ("200", "280")  # pixels of one picture
SHOWN = 6


def gva_mi(*words: str | Path) -> None:
    """Run a command, as a reader would."""
    command = [sys.executable, "-m", "gva_mi", *map(str, words)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def in_a_row(pictures: list[Path], out: Path) -> None:
    """Lay pictures side by side, in few colours, for they are part of the documentation."""
    row = np.concatenate([read_image(path, 3) for path in pictures], axis=1)
    Image.fromarray(row).quantize(128, dither=Image.Dither.NONE).save(out, optimize=True)


def motions(run: Path, folder: Path) -> list[Path]:
    """The avatar in the steps of somebody else, who dances."""
    dancer = folder / "dancer"
    plain = ("--frames", SHOWN, "--size", 32, "--samples", 1, "--no-clothes", "--no-hair")
    gva_mi("synth", dancer, "--motion", "dance", *plain, "--novel-poses", 0, "--novel-views", 0)
    poses = ("--poses", dancer / "truth/poses.npz")
    out = folder / "motions"
    gva_mi("render", run, *poses, "--path", "static", "--size", *SIZE, "--out", out)
    return sorted(out.glob("*.png"))


def exports(run: Path, folder: Path) -> list[Path]:
    """What a file without the body's rig holds, driven again and seen from all around."""
    alone = folder / "alone.npz"
    gva_mi("export", run, "--no-rig", "--out", alone)
    out = folder / "exports"
    path = ("--path", "turntable", "--frames", SHOWN, "--size", *SIZE)
    gva_mi("render", alone, "--poses", run / "poses.npz", *path, "--out", out)
    return sorted(out.glob("*.png"))


if __name__ == "__main__":
    run, out = map(Path, sys.argv[1:])
    with tempfile.TemporaryDirectory() as folder:
        in_a_row(motions(run, Path(folder)), out / "motions.png")
        in_a_row(exports(run, Path(folder)), out / "exports.png")
