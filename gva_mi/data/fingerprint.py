"""Check that a subject is used with the body model that its poses belong to.

Poses are rotations of one body's joints, and betas belong to that body. With another body, even a
slightly newer built-in one, they describe another person, and every error measured against the
ground truth is silently wrong. So ``synth.json`` and ``prepare.json`` keep a sketch of the body: K
signed sums of all its vertices x (metres) in two poses that use every joint, beta and expression,

    1. s_k = Σ_i σ_ki x_i / √V,    σ_ki = ±1 at random
    2. mean over k of (s_k - s'_k)²  ≈  mean over the vertices of |x_i - x'_i|²

so that two sketches tell how far apart two bodies are, and not only whether they differ.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BUILT_IN_NAME, BodyModel
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json

SUMS = 32  # K: their root mean square is right to one part in √(2 K), 12 %
SAME = 3e-6  # m, root mean square; float32 rounding is a tenth of it
# Files of a subject; each holds {"body": {"vertices": V, "sketch": [...]}}, the second also a
# "name" there, and the "file" of a body that is not built in.
SYNTH, PREPARED = "synth.json", "prepare.json"
FILM = "film"  # kind of a subject that was prepared from a film alone


def fingerprint(body: BodyModel) -> dict[str, object]:
    """Return vertex count and sketch (eq. 1, metres), as ``synth.json`` keeps them."""
    dtype = body.v_template.dtype
    wave = lambda n, size: size * torch.sin(1.0 + torch.arange(n, dtype=torch.float64)).to(dtype)
    shape = Shape(wave(body.num_betas, 1.5))
    bent = Pose(
        wave(165, 0.6).reshape(1, 55, 3), torch.zeros(1, 3, dtype=dtype),
        wave(body.num_expressions, 1.5)[None],
    )  # fmt: skip
    with torch.no_grad():
        states = torch.stack([body.rest(shape).vertices, body(bent, shape).vertices[0]])
    x = states.double().numpy() / np.sqrt(2)  # eq. 2 averages over both poses
    # RandomState, because its stream is frozen: a fingerprint outlives versions of numpy.
    signs = np.random.RandomState(0).randint(0, 2, (SUMS, *x.shape)) * 2.0 - 1
    sketch = np.einsum("ksvc,svc->k", signs, x) / np.sqrt(x.shape[1])
    return {"vertices": x.shape[1], "sketch": [round(float(s), 8) for s in sketch]}


def distance(a: dict[str, object], b: dict[str, object]) -> float:
    """Return the root mean square distance between two bodies' vertices (eq. 2), metres."""
    if a["vertices"] != b["vertices"]:
        return float("inf")
    return float(np.sqrt(np.square(np.subtract(a["sketch"], b["sketch"])).mean()))


def belongs_to(folder: Path, body: BodyModel) -> bool:
    """Whether a subject's folder says that it was made on, or prepared for, this very body."""
    known = (_body_of(folder / name, "gva-mi") for name in (SYNTH, PREPARED))
    return any(distance(x, fingerprint(body)) <= SAME for x in known if x is not None)


def require_same_body(folder: Path, body: BodyModel) -> None:
    """Raise an InputError if a subject was made on, or prepared for, another body.

    Folders without a fingerprint pass: those put together by hand, or older than this check.
    """
    for name, written_by in ((SYNTH, "gva-mi synth"), (PREPARED, "gva-mi prepare")):
        known = _body_of(Path(folder) / name, written_by)
        if known is None:
            continue
        away = distance(known, fingerprint(body))
        if away <= SAME:
            continue
        how = (
            f"{1000 * away:.2g} mm from this one on average"
            if np.isfinite(away)
            else f"of {known['vertices']} vertices, not {len(body.v_template)}"
        )
        if name == SYNTH:
            raise InputError(
                f"{folder}: made on another body ({how}), so that its poses and its ground truth "
                "mean nothing here; give the --body it was made with, or make it again with "
                "gva-mi synth"
            )
        theirs = known.get("name")
        given = f"--body with that body's file ({theirs})"
        expected = "the built-in body, that is no --body" if theirs == BUILT_IN_NAME else given
        raise InputError(
            f"{folder}: its poses were prepared for another body, {theirs} ({how}); "
            f"expected {expected}, or prepare it again for this body"
        )


def prepared_body(folder: Path) -> Path | None:
    """Return the body file that a subject was prepared for; None if there is none on record."""
    known = _body_of(Path(folder) / PREPARED, "gva-mi prepare") or {}
    return Path(known["file"]) if known.get("file") else None


def prepared_from(folder: Path) -> tuple[str | None, float | None]:
    """Return what a subject's poses were prepared from, and the frames a second of a film.

    Either is None if it is not known, both if the subject was not prepared.
    """
    file, expected = folder / PREPARED, "what gva-mi prepare writes"
    if not file.is_file():
        return None, None
    about = read_json(file, expected)
    with expecting(file, expected):
        fps = about.get("film", {}).get("fps")
        return about.get("kind"), None if fps is None else float(fps)


def _body_of(file: Path, written_by: str) -> dict | None:
    """Return the body that a subject's file describes; None if it describes none."""
    if not file.is_file():
        return None
    expected = f"what {written_by} writes"
    about = read_json(file, expected)
    with expecting(file, expected):
        body = about.get("body")
        if not isinstance(body, dict):  # older folders hold something else here, or nothing
            return None
        return body | {
            "sketch": np.reshape(np.float64(body["sketch"]), SUMS).tolist(),
            "vertices": body["vertices"],
        }
