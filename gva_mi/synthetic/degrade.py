"""Degrade an existing recording with other errors, so that a study renders each person once.

Frames and ground truth are hard-linked from the old folder if the disk allows it; estimates are
drawn anew. The result equals that of :func:`make_subject` for this error model and seed; earlier
errors of the recording have no effect. Only ``bursts`` degrades normals as rendered, so over files
its normals are up to one grey level off.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

from gva_mi.body.smplx import BodyModel
from gva_mi.core.atomic import atomic_dir
from gva_mi.core.console import Progress
from gva_mi.core.files import write_json
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.ground_truth import load_ground_truth
from gva_mi.synthetic.closest import closest
from gva_mi.synthetic.estimates import Pipeline, write_estimates
from gva_mi.synthetic.provenance import recorded_options


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
    """Write a recording's folder with other errors; it appears when it is complete.

    Args:
        subject: a folder that :func:`make_subject` or this function made.
        out: the new folder, which must not exist or be empty.
        family, seed: the error model, and the seed of its errors.
        body: the body that the subject was made on.
        level: factor on all errors; 0 is exact.
        progress: called as ``progress(done, total)`` after each frame.
        replaced: marker file of a folder that may be replaced once the new one is complete.

    Raises:
        InputError: ``out`` holds something else, ``subject`` was not made here or on another body,
            or there is no such error model.
    """
    subject = Path(subject)
    about, options = recorded_options(subject)
    require_same_body(subject, body)
    options = replace(
        options, family=family, noise_seed=seed, noise=level, pose_noise=1.0, mask_noise=1.0,
        normal_noise=1.0,
    )  # fmt: skip
    truth = load_ground_truth(subject / "truth", body)
    near = closest(body, truth.body, truth.pose, truth.shape)
    pipeline = Pipeline(options, body, truth.cameras, near)
    with atomic_dir(Path(out), replaced) as folder:
        for name in ("video.mp4", "film.mp4", "frames", "truth", "splits.json"):
            if (subject / name).is_dir():
                shutil.copytree(subject / name, folder / name, copy_function=_link)
            elif (subject / name).exists():
                _link(subject / name, folder / name)
        statistics = []
        for k, errors in enumerate(pipeline.pictures()):
            statistics.append(write_estimates(folder, k, errors, options.samples))
            if progress is not None:
                progress(k + 1, len(near.pose))
        pipeline.write(folder, statistics)
        write_json(folder / "synth.json", about | {"options": options.recorded()})


def _link(source: Path | str, target: Path | str) -> None:
    """Hard-link a file, or copy it where links are not possible."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
