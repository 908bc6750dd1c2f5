"""MoSh's second stage, as MoSh++ pickles it with its settings, and as it was before."""

import pickle
import sys
from collections import defaultdict
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from gva_mi.core.errors import InputError
from gva_mi.readers.motions import MotionOptions, read_motion
from gva_mi.readers.target_body import TargetBody

AS_IT_IS = MotionOptions(fps=120, hands="flat")


@pytest.fixture
def settings(monkeypatch):
    """A maker of OmegaConf's nodes, whose pickles hold classes of its modules and of typing."""
    kinds = {}
    for name in ("base.ContainerMetadata", "dictconfig.DictConfig", "listconfig.ListConfig",
                 "nodes.AnyNode"):  # fmt: skip
        module, kind = f"omegaconf.{name.split('.')[0]}", name.split(".")[1]
        kinds[kind] = type(kind, (), {"__module__": module})
        for part in ("omegaconf", module):
            monkeypatch.setitem(sys.modules, part, sys.modules.get(part, ModuleType(part)))
        setattr(sys.modules[module], kind, kinds[kind])

    def node(kind, **fields):
        metadata = kinds["ContainerMetadata"]()
        metadata.__dict__ |= {"ref_type": Any, "key_type": Any, "element_type": int,
                              "resolver_cache": defaultdict(dict)}  # fmt: skip
        found = kinds[kind]()
        found.__dict__ |= {"_metadata": metadata, "_parent": None, "_flags_cache": None, **fields}
        return found

    def of(value):
        if isinstance(value, dict):
            return node("DictConfig", _content={k: of(x) for k, x in value.items()})
        if isinstance(value, list):
            return node("ListConfig", _content=[of(x) for x in value])
        return node("AnyNode", _val=value)

    return of


def test_stage_two_is_a_motion(tmp_path, walk, settings):
    rotations, transl = walk(9)
    poses = rotations.reshape(9, 165)
    body = {"type": "smplx", "gender": "male", "num_betas": 16, "num_expressions": 80}
    now = {
        "fullpose": poses, "trans": transl, "betas": np.linspace(0, 1, 400),
        "markers_latent": np.zeros((41, 3)), "latent_labels": ["ARIEL"],
        "marker_meta": {"body": {1, 2}},
        "stageii_debug_details": {
            "mocap_frame_rate": 120.0, "labels_obs": [["ARIEL"]] * 9,
            "cfg": settings({"surface_model": body, "moshpp": {"wrists": [1, 2.5, None]}}),
        },
    }  # fmt: skip
    before = {"pose_est_fullposes": poses, "pose_est_trans": transl, "mocap_framerate": 120,
              "shape_est_betas": np.linspace(0, 1, 400)[:16], "ps": {"num_betas": 16},
              "pose_est_exprs": np.zeros((9, 80))}  # fmt: skip
    np.savez(tmp_path / "amass.npz", poses=poses, trans=transl, mocap_frame_rate=120.0,
             betas=np.linspace(0, 1, 400)[:16])  # fmt: skip
    wanted = read_motion(tmp_path / "amass.npz", TargetBody.read(None), AS_IT_IS)
    for found in (now, before):
        path = tmp_path / "walk_stageii.pkl"
        path.write_bytes(pickle.dumps(found))
        motion = read_motion(path, TargetBody.read(None), AS_IT_IS)
        assert (motion.pose.rotations == wanted.pose.rotations).all()
        assert (motion.pose.transl == wanted.pose.transl).all()
        assert (motion.shape.betas == wanted.shape.betas).all() and len(motion.shape.betas) == 16
        assert motion.notes[0] == wanted.notes[0]
    del now["stageii_debug_details"]["mocap_frame_rate"]
    path.write_bytes(pickle.dumps(now))
    with pytest.raises(InputError, match="holds no frame rate .*give --source-fps"):
        read_motion(path, TargetBody.read(None), AS_IT_IS)
