"""Check that a subject is used with the body model that its poses belong to.

Poses are rotations of one body's joints, and betas belong to that body. With another body, even a
slightly newer built-in one, they describe another person, and every error measured against the
ground truth is silently wrong. So ``synth.json`` and ``prepare.json`` keep a sketch of the body: K
signed sums of all its vertices x (metres) in two poses that use every joint, beta and expression,

    1. s_k = Σ_i σ_ki x_i / √V,    σ_ki = ±1 at random
    2. mean over k of (s_k - s'_k)²  ≈  mean over the vertices of |x_i - x'_i|²

so two sketches tell how far apart two bodies are, not only whether they differ.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json
from gva_mi.subject.folder import LANDMARKS, MASKS, PREPARED, SYNTH, TRUTH, frame_name

SKETCH_SUMS = 32  # K. Chosen: the root mean square is right to one part in √(2 K), 12 %
SAME_BODY_METRES = 3e-6  # root mean square. Chosen: ten times float32's rounding
# Both records hold {"body": {"vertices": V, "sketch": [...]}}; PREPARED also the body's "name", and
# its "file" unless it is the built-in body.
EXPECTED_RECORD = "what gva-mi synth or gva-mi prepare writes"
VIDEO_KIND = "video"  # "kind" in PREPARED of a subject that stage 1 made from a video file


def fingerprint(body: BodyModel) -> dict[str, object]:
    """Return the vertex count and the sketch (eq. 1, metres) of a body, for its record."""
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
    signs = np.random.RandomState(0).randint(0, 2, (SKETCH_SUMS, *x.shape)) * 2.0 - 1
    sketch = np.einsum("ksvc,svc->k", signs, x) / np.sqrt(x.shape[1])
    return {"vertices": x.shape[1], "sketch": [round(float(s), 8) for s in sketch]}


def distance(a: dict[str, object], b: dict[str, object]) -> float:
    """Return the root mean square distance between two bodies' vertices (eq. 2), metres."""
    if a["vertices"] != b["vertices"]:
        return float("inf")
    return float(np.sqrt(np.square(np.subtract(a["sketch"], b["sketch"])).mean()))


def belongs_to(folder: Path, body: BodyModel) -> bool:
    """Whether a subject's folder was made on, or prepared for, this body, by its records."""
    known = (_body_of(folder / name) for name in (SYNTH, PREPARED))
    return any(distance(x, fingerprint(body)) <= SAME_BODY_METRES for x in known if x)


def require_same_body(folder: Path, body: BodyModel) -> None:
    """Raise an InputError if a subject was made on, or prepared for, another body.

    A folder without a record, such as one that was put together by hand, passes.
    """
    for name in (SYNTH, PREPARED):
        known = _body_of(Path(folder) / name)
        away = distance(known, fingerprint(body)) if known else 0.0
        if away <= SAME_BODY_METRES:
            continue
        how = (
            f"{1000 * away:.2g} mm from this one on average"
            if np.isfinite(away)
            else f"of {known['vertices']} vertices, not {len(body.v_template)}"
        )
        theirs = known.get("name", "the one that gva-mi synth was given")
        raise InputError(
            f"{folder}: its poses belong to another body ({how}), so they are wrong for this one; "
            f"expected --body with that body ({theirs}), or make the folder again for this body"
        )


def prepared_body(folder: Path) -> Path | None:
    """Return the body file that a subject was prepared for; None if there is none on record."""
    file = _body_of(Path(folder) / PREPARED).get("file")
    return Path(file) if file else None


def prepared_from(folder: Path) -> tuple[str | None, float | None]:
    """Return the kind of source that a subject was prepared from, and its frames a second.

    Both are None without ``prepare.json``, the second one unless the source was a video file.
    """
    about = _record(folder / PREPARED)
    with expecting(folder / PREPARED, EXPECTED_RECORD):
        fps = about.get("video", {}).get("fps")
        return about.get("kind"), None if fps is None else float(fps)


def require_listed(folder: Path, count: int) -> None:
    """Raise an InputError if a file of a subject with ``count`` frames has got lost.

    The records list the files. Landmarks come with a record, and true masks with one for each
    frame; without them, steps would use defaults and estimates instead.
    """
    wanted = {PREPARED: LANDMARKS} if (folder / LANDMARKS).exists() else {}
    for name in (PREPARED, SYNTH):
        with expecting(folder / name, EXPECTED_RECORD):
            wanted |= {str(part): name for part in _record(folder / name).get("files", ())}
    masks = f"{TRUTH}/{MASKS}"
    if (folder / masks).is_dir():
        wanted |= {f"{masks}/{frame_name(k)}": masks for k in range(count)}
    for part, other in wanted.items():
        if not (folder / part).exists():
            raise InputError(f"{folder}: has lost its {part}, which {other} needs; restore it")


def _record(file: Path) -> dict:
    return read_json(file, EXPECTED_RECORD) if file.is_file() else {}


def _body_of(file: Path) -> dict:
    """Return what a record says of the body; an empty dictionary if it says nothing."""
    about = _record(file)
    with expecting(file, EXPECTED_RECORD):
        body = about.get("body", {})
        sketch = np.reshape(np.float64(body["sketch"]), SKETCH_SUMS).tolist() if body else []
        return {**body, "sketch": sketch, "vertices": body["vertices"]} if body else {}
