"""Pictures of the documentation that show the avatar of the demo.

    python docs/gallery_pictures.py DEMO OUT

DEMO is the folder of ``gva-mi demo``; ``overview.png``, ``check.png``, ``motions.png`` and
``exports.png`` are written into OUT.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from gva_mi.body.smplx import load_body
from gva_mi.data.pictures import read_image
from gva_mi.study.regions import person_box
from gva_mi.synthetic import SynthOptions, make_subject

SIZE = ("240", "340")  # pixels of one picture
SHOWN = 6


def gva_mi(*words: str | Path) -> None:
    """Run a command, as a reader would."""
    command = [sys.executable, "-m", "gva_mi", *map(str, words)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def in_a_row(pictures: list[Path]) -> np.ndarray:
    """Lay pictures side by side, each cut to what is not white, all to the same rows."""
    images = [read_image(path, 3) for path in pictures]
    drawn = [image.min(-1) < 250 for image in images]
    all_rows, cut = person_box(np.any(drawn, axis=0)), []
    for image, inside in zip(images, drawn, strict=True):
        own = person_box(inside)
        cut.append(image[all_rows.top : all_rows.bottom, own.left : own.right])
    return np.concatenate(cut, axis=1)


def save(image: np.ndarray, out: Path) -> None:
    """Write a picture in few colours, because it is part of the documentation."""
    Image.fromarray(image).quantize(200, dither=Image.Dither.NONE).save(out, optimize=True)


def motions(run: Path, folder: Path) -> list[Path]:
    """The avatar in the steps of somebody else, who dances."""
    dancer = folder / "dancer"
    options = SynthOptions(
        motion="dance", frames=SHOWN, size=32, samples=1, clothes=False, hair=False,
        novel_poses=0, novel_views=0,
    )  # fmt: skip
    make_subject(dancer, options, load_body())
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
    demo, out = map(Path, sys.argv[1:])
    shutil.copyfile(demo / "run/overview.png", out / "overview.png")  # its normals need all colours
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        gva_mi("check", demo / "subject", "--sheet", folder / "check.png")
        save(read_image(folder / "check.png", 3), out / "check.png")
        save(in_a_row(motions(demo, folder)), out / "motions.png")
        save(in_a_row(exports(demo, folder)), out / "exports.png")
