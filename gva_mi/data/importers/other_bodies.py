"""Parameters of bodies that are not read, told by their names before anybody takes them for noise.

MHR is the body of SAM 3D Body: 127 joints, shapes and scales of its own. Its parameters are written
a person a dictionary, in lists a frame, under ``outputs``, or in an ``.npz`` of objects.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any

import numpy as np

from gva_mi.errors import InputError

_OF_MHR = {"mhr_model_params", "mhr_shape_params", "body_pose_params"}
_DEEP = 4  # a list of frames in an array of objects under "outputs", each a list of people
_SOME = 20  # entries of a container that are looked at: frames are alike


def refuse_other_bodies(where: object, found: Any) -> None:  # noqa: ANN401
    """Say by name which body's parameters a file holds, however deep, where it is none of SMPL's.

    Args:
        where: the file or folder, for the sentence.
        found: what it holds.

    Raises:
        InputError: they are parameters of MHR.
    """
    if _has_mhr(found, _DEEP):
        raise InputError(
            f"{where}: holds parameters of MHR, as SAM 3D Body writes, which is another body than "
            "SMPL-X; fit SMPL-X to its vertices with MHR's own conversion, and save that by name"
        )


def _has_mhr(found: Any, deep: int) -> bool:  # noqa: ANN401
    inner: Any = ()
    if isinstance(found, Mapping):
        if _OF_MHR & {name for name in found if isinstance(name, str)}:
            return True
        inner = found.values()
    elif isinstance(found, list | tuple):
        inner = found
    elif isinstance(found, np.ndarray) and found.dtype.hasobject:
        inner = found.ravel()[:_SOME].tolist()
    return deep > 0 and any(_has_mhr(x, deep - 1) for x in islice(inner, _SOME))
