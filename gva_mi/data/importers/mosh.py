"""Read MoSh's second stage, ``*_stageii.pkl``, of which AMASS's files are made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_NAMES = {  # of MoSh++ (SOMA), or of MoSh before: AMASS's
    "fullpose": "poses", "trans": "trans", "betas": "betas", "expression": "expression",
    "pose_est_fullposes": "poses", "pose_est_trans": "trans", "shape_est_betas": "betas",
    "pose_est_exprs": "expression",
}  # fmt: skip
_DETAILS = "stageii_debug_details"  # of MoSh++: frame rate and settings
_BETAS = 10  # of a body of which the settings say nothing


def from_mosh(found: Any) -> Any:  # noqa: ANN401
    """Return the arrays of MoSh's result under AMASS's names; anything else as it is.

    Its settings say how many of the coefficients were used.
    """
    if not isinstance(found, Mapping) or not {_DETAILS, "pose_est_fullposes"} & set(found):
        return found
    details = found.get(_DETAILS, found)
    settings = details.get("cfg", details.get("ps"))
    model = settings.get("surface_model", settings) if isinstance(settings, Mapping) else {}
    renamed = {ours: found[name] for name, ours in _NAMES.items() if name in found}
    rate = details.get("mocap_frame_rate", details.get("mocap_framerate"))
    renamed |= {} if rate is None else {"mocap_frame_rate": rate}
    for name, count in (("betas", model.get("num_betas", _BETAS)),
                        ("expression", model.get("num_expressions"))):  # fmt: skip
        if name in renamed and isinstance(count, int):
            renamed[name] = renamed[name][..., :count]
    return renamed
