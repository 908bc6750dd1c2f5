"""The articulated body, in torch: Eq. 4 and the skinning of Eq. 5 and 6.

==================  ================================================================
``pose``            ``Pose`` and ``Shape``: what moves a body, and their files
``smplx``           the parametric body: shape and pose to vertices and joints
``body_file``       body files of SMPL-X, SMPL+H and SMPL, read and checked
``smpl``            the older formats on SMPL-X's joints, and their poses
``puppet, anny``    the two bodies that need no licence
``kinematics``      rotations of joints to rigid maps
``blend_shapes``    a surface plus a weighted sum of directions
``skinning``        points and Gaussians that follow the joints
``polar``           the rotation nearest to a blend of rotations
``gestures``        poses of the hands
``bench``           how fast all of it is
==================  ================================================================
"""

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, Pose, Shape, load_poses, save_poses
from gva_mi.body.skinning import skin_gaussians, skin_points
from gva_mi.body.smpl import keep_pelvis, pose_from_smpl, pose_from_smplh
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
    "keep_pelvis",
    "load_body",
    "load_poses",
    "pose_from_smpl",
    "pose_from_smplh",
    "save_poses",
    "skin_gaussians",
    "skin_points",
]
