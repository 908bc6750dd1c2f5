"""Provenance of a subject's folder: read its options, and make its person again."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gva_mi.body.smplx import BodyModel
from gva_mi.core.atomic import atomic_write
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json
from gva_mi.data.fingerprint import ABOUT, require_same_body
from gva_mi.synthetic.options import SynthOptions
from gva_mi.synthetic.subject import Subject

RETIRED = ("background", "blur", "sensor_noise")  # options of older folders; only frames differ
SURFACE = "truth/surface.ply"  # in the subject's folder


def recorded_options(subject: Path) -> tuple[dict, SynthOptions]:
    """Read a subject's ``synth.json`` and the options in it.

    Raises:
        InputError: the folder was not made by ``gva-mi synth``.
    """
    path = subject / ABOUT
    expected = "a folder that gva-mi synth made"
    about = read_json(path, expected)
    with expecting(path, expected):
        kept = {k: v for k, v in about["options"].items() if k not in RETIRED}
        return about, SynthOptions(**kept)


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
    drawn_on = options.drawn_on(body)
    person = options.subject_on(drawn_on)
    if not (subject / SURFACE).is_file():
        return None
    filmed = trimesh.load(subject / SURFACE, process=False)
    same = np.array_equal(filmed.faces, person.faces)
    same = same and np.allclose(filmed.vertices, person.vertices, atol=1e-6)
    return (person, drawn_on) if same else None
