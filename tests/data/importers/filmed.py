"""Where the camera of the data sets stood, and what it saw: numbers that several files of tests
share."""

import numpy as np
import roma
import torch

WIDTH, HEIGHT, FRAMES = 64, 48, 5
SMPL, SMPLX = np.array([-0.0018, -0.2233, 0.0282]), np.array([0.0031, -0.3514, 0.0120])  # pelvises
K = np.array([[70.0, 0, 33], [0, 72, 23], [0, 0, 1]])
TURN, MOVE = np.array([0.1, -0.4, 0.05]), np.array([0.2, 0.1, 0.5])  # x_cam = R(TURN) x + MOVE
BUILT_IN_BODY = ("--body", "puppet")
MASK = np.zeros((HEIGHT, WIDTH), np.uint8)
MASK[10:40, 20:40] = 255


def matrices(rotations):
    return roma.rotvec_to_rotmat(torch.as_tensor(rotations, dtype=torch.float64)).numpy()


def vectors(R):
    return roma.rotmat_to_rotvec(torch.as_tensor(R, dtype=torch.float64)).numpy()


def shots():
    random = np.random.default_rng(0)
    return [random.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8) for _ in range(FRAMES)]
