"""An existing subject's folder: its options, its person again, its recording with other errors.

A degraded recording equals what :func:`make_subject` makes with this error model and seed; earlier
errors have no effect. Only ``bursts`` degrades normals as rendered: from files, they are up to one
grey level off.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from gva_mi.body.smplx import BodyModel
from gva_mi.core.atomic import atomic_dir, atomic_write
from gva_mi.core.console import Progress
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json, write_json
from gva_mi.data.fingerprint import SYNTH, require_same_body
from gva_mi.data.folder import FRAMES, SPLITS, TRUTH, VIDEO
from gva_mi.data.ground_truth import load_ground_truth
from gva_mi.synthetic.closest import closest
from gva_mi.synthetic.estimates import Pipeline, write_estimates
from gva_mi.synthetic.options import SynthOptions
from gva_mi.synthetic.subject import Subject

SURFACE = "truth/surface.ply"  # in the subject's folder


def recorded_options(subject: Path) -> tuple[dict, SynthOptions]:
    """Read a subject's ``synth.json`` and the options in it.

    Raises:
        InputError: the folder was not made by ``gva-mi synth``.
    """
    path, expected = subject / SYNTH, "a folder that gva-mi synth made"
    about = read_json(path, expected)
    with expecting(path, expected):
        return about, SynthOptions(**about["options"])


def write_surface(path: Path, person: Subject) -> None:
    """Write a person's outer surface in the rest pose."""
    import trimesh

    mesh = trimesh.Trimesh(person.vertices, person.faces, process=False)
    with atomic_write(path) as unfinished:
        unfinished.write_bytes(trimesh.exchange.ply.export_ply(mesh, vertex_normal=False))


def remake_subject(subject: Path, body: BodyModel) -> tuple[Subject, BodyModel] | None:
    """Make the person of a folder again, with materials and binding, and the body drawn on.

    The folder holds only the outer surface. If it differs, because another version of this program
    made it, the result is None. ``body`` is that of its stage-1 poses.

    Raises:
        InputError: the folder was not made by ``gva-mi synth``, or on another body.
    """
    import trimesh

    require_same_body(subject, body)
    _, options = recorded_options(subject)
    if not (subject / SURFACE).is_file():
        return None
    drawn_on = options.drawn_on(body)
    person = options.subject_on(drawn_on)
    filmed = trimesh.load(subject / SURFACE, process=False)
    same = np.array_equal(filmed.faces, person.faces)
    same = same and np.allclose(filmed.vertices, person.vertices, atol=1e-6)
    return (person, drawn_on) if same else None


def degrade(
    subject: Path,
    out: Path,
    error_model: str,
    seed: int,
    body: BodyModel,
    level: float = 1.0,
    progress: Progress | None = None,
    replaced: str | None = None,
) -> None:
    """Write a recording with other errors, so that each person is rendered once.

    The folder appears when it is complete. Frames and ground truth are hard-linked from the old one
    if the disk allows it.

    Args:
        subject: a folder that :func:`make_subject` or this function made.
        out: the new folder, which must not exist or be empty.
        error_model, seed: the error model, and the seed of its errors.
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
    options = replace(options, error_model=error_model, noise_seed=seed, noise=level)
    truth = load_ground_truth(subject / TRUTH, body)
    near = closest(body, truth.body, truth.pose, truth.shape)
    pipeline = Pipeline(options, body, truth.cameras, near)
    with atomic_dir(Path(out), replaced) as folder:
        for name in (VIDEO, "film.mp4", FRAMES, TRUTH, SPLITS):
            if (subject / name).is_dir():
                shutil.copytree(subject / name, folder / name, copy_function=_link)
            elif (subject / name).exists():
                _link(subject / name, folder / name)
        for k, errors in enumerate(pipeline.pictures()):
            write_estimates(folder, k, errors, options.samples)
            if progress is not None:
                progress(k + 1, len(near.pose))
        pipeline.write(folder)
        write_json(folder / SYNTH, about | {"options": options.recorded()})


def _link(source: Path | str, target: Path | str) -> None:
    """Hard-link a file, or copy it where links are not possible."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
