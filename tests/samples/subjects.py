"""Subject folders that are rendered from a known avatar."""

import torch

from gva_mi.avatar.avatar import AVATAR_SPLATTING
from gva_mi.body.pose import save_poses
from gva_mi.splat import render
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.pictures import in_8_bits, write_image


def write_subject(folder, avatar, camera, pose, shape):
    """Write frames with a grey background, alpha as masks, poses and cameras; return the folder."""
    for k in range(len(pose)):
        with torch.no_grad():
            image = render(avatar(pose[k]), camera, AVATAR_SPLATTING, torch.full((3,), 0.3))
        write_image(folder / f"frames/{k:06d}.png", in_8_bits(image.color.numpy()))
        write_image(folder / f"masks/{k:06d}.png", in_8_bits(image.alpha.numpy()))
    save_poses(folder / "poses.npz", pose, shape, stage=1)
    save_cameras(folder / "cameras.npz", [camera] * len(pose))
    return folder
