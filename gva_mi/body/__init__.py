"""The articulated body, in torch: Eq. 4 and the skinning of Eq. 5 and 6."""

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, Pose, Shape, load_poses, save_poses
from gva_mi.body.skinning import nearest_weights, skin_gaussians, skin_points
from gva_mi.body.smplx import BodyModel, Posed, Rest, load_body

__all__ = [
    "JOINTS",
    "PARENTS",
    "BodyModel",
    "Pose",
    "Posed",
    "Rest",
    "Shape",
    "joint_transforms",
    "load_body",
    "load_poses",
    "nearest_weights",
    "save_poses",
    "skin_gaussians",
    "skin_points",
]
