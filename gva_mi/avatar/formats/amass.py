"""AMASS's format of poses in SMPL-X's joints, which most programs that know a body can read.

========================  ===========  =====================================================
``poses``                 (T, 165)     axis-angle: root, body 21, jaw, eyes, left, right hand
``trans``                 (T, 3)       metres
``betas``                 (B,)         shape
``gender``                ``str``      of the body model
``mocap_frame_rate``      number       frames a second
``surface_model_type``    ``"smplx"``
``expression``            (T, E)       in addition to AMASS's own keys, which have no face
========================  ===========  =====================================================

Hands are relative to the flat hand. The world stays the poses' own; AMASS's has z upward.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gva_mi.body.pose import Pose, Shape
from gva_mi.core.files import write_arrays


def save_amass(path: Path, pose: Pose, shape: Shape, fps: float) -> None:
    """Write T poses in AMASS's format, atomically."""
    array = lambda tensor: tensor.detach().numpy()
    write_arrays(
        path,
        poses=array(pose.rotations.flatten(1)),
        trans=array(pose.transl),
        betas=array(shape.betas),
        expression=array(pose.expression),
        gender=np.array("neutral"),
        mocap_frame_rate=np.array(float(fps)),
        surface_model_type=np.array("smplx"),
    )
