"""Files that a refinement leaves in the subject's folder.

::

    subject/
      poses_refined.npz   all frames, and the offsets of the displaced surface: gva_mi.body.pose
      refinement.json     figures, frames that kept their stage-1 pose and why, options, versions
      refinement.png      the body over some frames: stage 1 above, refined below

The other two files always belong to the poses in the folder. The paper refines test frames too,
from their own masks and normals: ``"test_frames": "seen"``. If they were ``"held out"``, their
poses follow from the other frames, and ``figures_by_split`` lists both. ``stage1_errors`` are the
inferred standard deviations of stage 1's errors (radians for joints, metres for the place) and
their duration in frames. ``footing``: deviation of standing soles from one plane, share of the time
they stand, and their height otherwise, metres. ``swapped``: frames whose legs, or arms, were
exchanged left and right before the refinement.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import save_poses
from gva_mi.core.atomic import atomic_files
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json, write_json
from gva_mi.data.pictures import in_8_bits, write_image
from gva_mi.data.splits import spread
from gva_mi.data.video import REFINED_POSES
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.mesh.overlay import overlay, strip
from gva_mi.study.measure import Evaluation, PoseFigures
from gva_mi.study.regions import person_box

REFINEMENT, OVERLAYS = "refinement.json", "refinement.png"
SHOWN = 8  # frames in the picture
MARGIN = 0.1  # around the person, a share of the longer side


def write_record(evaluation: Evaluation, versions: dict[str, str]) -> None:
    """Write the three files."""
    video, refined, options = evaluation.video, evaluation.refined, evaluation.options
    folder: Path = video.folder
    record = {
        "figures": evaluation.measured.means.to_json(),
        "stage1_errors": {name: asdict(noise) for name, noise in refined.noise.items()},
        "footing": None if refined.contact is None else asdict(refined.contact),
        "swapped": refined.swapped,
        "test_frames": "held out" if refined.held_out else "seen",
        **({"figures_by_split": _by_split(evaluation)} if refined.held_out else {}),
        "kept": refined.kept,
        "without_normals": refined.without_normals,
        "normals": video.normals.convention if video.normals else None,
        "options": {"loss": options.name, **asdict(options)},
        "versions": versions,
    }
    pose, shape, offsets = refined.pose, refined.shape, refined.offsets
    with atomic_files(folder / REFINED_POSES, REFINEMENT, OVERLAYS) as unfinished:
        save_poses(unfinished / REFINED_POSES, pose, shape, stage=2, offsets=offsets)
        write_json(unfinished / REFINEMENT, record)
        write_image(unfinished / OVERLAYS, _overlays(evaluation))


def load_refinement(subject: Path) -> tuple[PoseFigures, bool]:
    """Read a subject's figures, and whether its refinement saw the test frames.

    A subject without the file has no figures; the paper's protocol, which sees them, is assumed.

    Raises:
        InputError: the file cannot be read.
    """
    path, expected = subject / REFINEMENT, "what `gva-mi refine` writes"
    if not path.exists():
        return PoseFigures.from_json({}), True
    record = read_json(path, expected)
    with expecting(path, expected):
        figures = PoseFigures.from_json(record["figures"])
        return figures, record.get("test_frames", "seen") == "seen"


def _by_split(evaluation: Evaluation) -> dict[str, dict]:
    """Return the figures of seen and of held-out frames."""
    held_out = evaluation.refined.held_out
    seen = [k for k in range(len(evaluation.video)) if k not in held_out]
    splits = {"train": seen, "test": held_out}
    return {name: evaluation.measured.of(some).means.to_json() for name, some in splits.items()}


@torch.no_grad()
def _overlays(evaluation: Evaluation) -> np.ndarray:
    """Draw bodies over evenly spaced frames, stage 1 above, refined below, in 8 bits."""
    video, body, refined = evaluation.video, evaluation.body, evaluation.refined
    shown = spread([k for k in range(len(video)) if k not in video.absent], SHOWN)
    scene, cameras = MeshScene(body.faces, body.v_template), refined.cameras or video.cameras
    seen = np.any([outline.mask > 0.5 for outline in video.outlines(shown)], axis=0)
    part = person_box(seen if seen.any() else ~seen, MARGIN)
    rows: list[list[np.ndarray]] = [[], []]
    for frame in video.frames(shown):  # one at a time: eight of 1080p as floats take a gigabyte
        k = frame.index
        before, after = body(video.pose[k], video.shape), body(refined.pose[k], refined.shape)
        for row, posed, camera in ((rows[0], before, frame.camera), (rows[1], after, cameras[k])):
            drawn = overlay(frame.image, camera, posed.vertices[0], body.faces, scene)
            row.append(in_8_bits(part.cut(drawn)))
    return strip(rows)
