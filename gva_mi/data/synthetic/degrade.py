"""The same recording under another noise, so that a study of many renders each person once.

Frames and truth are those of a subject that is there, by hard links where the disk allows it; what
a pipeline says about them is drawn anew. The folder holds what :func:`make_subject` would write
with that family and that seed of the noise, whatever noise the subject had before. ``bursts`` alone
starts from normals as they were rendered: over files, its normals are up to a grey level off.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

from gva_mi.body.smplx import BodyModel
from gva_mi.console import Progress
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.synthetic.closest import closest
from gva_mi.data.synthetic.estimates import Pipeline, spoil_pictures
from gva_mi.data.synthetic.recorded import made_of
from gva_mi.data.truth import load_truth
from gva_mi.files import replacing, whole_folder, write_json

KEPT = ("video.mp4", "frames", "truth", "splits.json")


def degrade(
    subject: Path,
    out: Path,
    family: str,
    seed: int,
    body: BodyModel,
    level: float = 1.0,
    progress: Progress | None = None,
    replaced: str | None = None,
) -> None:
    """Write a recording's folder with another noise; it appears when it is complete.

    Args:
        subject: a folder that :func:`make_subject` or this function made.
        out: the new folder, which must not exist or be empty.
        family: of the noise.
        seed: of the noise.
        body: the body that the subject was made on.
        level: factor on all of the noise; 0 is exact.
        progress: called as ``progress(done, total)`` after each frame.
        replaced: the marker of a folder that may be replaced, once the new one is complete.

    Raises:
        InputError: ``out`` already holds something else; ``subject`` is none that was made here, or
            on another body; there is no such family.
    """
    subject, out = Path(subject), Path(out)
    about, options = made_of(subject)
    require_same_body(subject, body)
    options = replace(
        options, family=family, noise_seed=seed, noise=level, pose_noise=1.0, mask_noise=1.0,
        normal_noise=1.0,
    )  # fmt: skip
    truth = load_truth(subject / "truth", body)
    near = closest(body, truth.body, truth.pose, truth.shape)
    pipeline = Pipeline(options, body, truth.cameras, near)
    with whole_folder(out, replaced) as folder:
        for name in KEPT:
            if (subject / name).exists():
                _linked(subject / name, folder / name)
        # Older subjects have none: all their noise left the camera alone.
        if not (folder / "truth" / "cameras.npz").exists():
            _linked(subject / "cameras.npz", folder / "truth" / "cameras.npz")
        errors = []
        for k, noise in enumerate(pipeline.pictures()):
            errors.append(spoil_pictures(folder, k, noise, options.samples))
            if progress is not None:
                progress(k + 1, len(near.pose))
        pipeline.write(folder, errors)
        write_json(folder / "synth.json", about | {"options": options.recorded()})


def _linked(source: Path, target: Path) -> None:
    """The same files at another place: links, or copies where there can be none."""
    if source.is_dir():
        target.mkdir(parents=True, exist_ok=True)
        for path in sorted(source.iterdir()):
            _linked(path, target / path.name)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        with replacing(target) as unfinished:
            shutil.copy2(source, unfinished)
