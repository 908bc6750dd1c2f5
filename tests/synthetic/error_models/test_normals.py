"""Error model of normals: unit length, facing the camera, with bias."""

import numpy as np

from gva_mi.data.normals import NormalMaps, in_convention
from gva_mi.synthetic.error_models.normals import NormalErrors, noisy_normals

USUAL = NormalErrors()
STILL = NormalErrors(blur=0.0, tilt=0.0)


def test_normals_stay_unit_face_the_camera_and_fill_the_mask(disc, rng):
    mask, normals = disc
    wider = (np.hypot(*(np.mgrid[:64, :64] - 31.5)) < 26).astype(np.float32)
    noisy = noisy_normals(normals, wider, USUAL, 1.0, rng)
    length = np.linalg.norm(noisy, axis=-1)
    assert np.allclose(length[wider > 0.5], 1, atol=1e-5) and (length[wider <= 0.5] == 0).all()
    assert (noisy[..., 2] <= 0).all()
    both = normals.any(-1) & noisy.any(-1)
    cosine = (noisy * normals).sum(-1)[both].clip(-1, 1)
    assert 2 < np.degrees(np.arccos(cosine)).mean() < 20


def test_flat_normals_turn_toward_the_camera_everywhere(disc, rng):
    mask, normals = disc
    plain = noisy_normals(normals, mask, STILL, 1.0, rng)
    flat = noisy_normals(normals, mask, NormalErrors(blur=0.0, tilt=0.0, flat=0.3), 1.0, rng)
    inner = np.hypot(*(np.mgrid[:64, :64] - 31.5)) < 20
    across = lambda n: np.hypot(n[..., 0], n[..., 1])[inner] / -n[..., 2][inner]
    assert np.allclose(across(flat), 0.7 * across(plain), atol=1e-4)


def test_icons_convention_is_read_back(disc, camera, tmp_path):
    _, normals = disc
    (tmp_path / "normals").mkdir()
    np.save(
        tmp_path / "normals/000000.npy", in_convention(normals, camera, "icon").astype(np.float32)
    )
    read = NormalMaps(tmp_path / "normals", "icon", None).read(0, camera)
    assert np.abs(read - normals).max() < 1e-6
