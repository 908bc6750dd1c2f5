"""A ball as a subject, which has closed-form answers; a bare subject's folder, and its bytes."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Shape
from gva_mi.synthetic import SynthOptions, make_subject
from gva_mi.synthetic.person.identity import NAMED, Fabric
from gva_mi.synthetic.person.surface import PersonSurface
from gva_mi.synthetic.person.texture import FaceLandmarks, Look, Material

GREY = Fabric("plain", ((0.5, 0.5, 0.5),) * 3, 0.05)
PERSON = replace(NAMED["amira"], skin=(0.5, 0.4, 0.3), hair=(0.1, 0.1, 0.1), top=GREY, bottom=GREY,
    shoes=(0.3, 0.3, 0.3))  # fmt: skip
LOOK = Look(
    PERSON, swimsuit=False, face=FaceLandmarks(((0.03, 9, 0), (-0.03, 9, 0)), (0, 9, 0), 0.06),
    nails=(), shoulder=(0.2, 9, 0), hip=(0.1, 8, 0), ground=-9.0,
)  # fmt: skip
RADIUS = 0.5  # m


@pytest.fixture(scope="session")
def ball():
    import trimesh
    from scipy.sparse import csr_array

    mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    count = len(mesh.vertices)
    return PersonSurface(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int64),
        csr_array((count, 1)), torch.eye(55)[:1].expand(count, 55), np.ones((count, 3), np.float32),
        np.full(len(mesh.faces), int(Material.TOP), np.uint32), LOOK, Shape(torch.zeros(10)),
        np.zeros(count), ())  # fmt: skip


BARE = SynthOptions(frames=3, size=64, samples=16, bare=True, novel_poses=1, novel_views=1)


@pytest.fixture(scope="session")
def bare():
    """Options of a small subject, with the usual errors."""
    return BARE


@pytest.fixture(scope="session")
def noisy(body, tmp_path_factory):
    """The folder of a bare body with the usual errors."""
    pytest.importorskip("mitsuba")
    out = tmp_path_factory.mktemp("noisy") / "subject"
    make_subject(out, BARE, body)
    return out


@pytest.fixture(scope="session")
def files():
    """Return a function from a folder to its files' bytes, by name."""
    return lambda folder: {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
