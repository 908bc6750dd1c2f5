"""BVH of other skeletons: limbs point where they did, and the body's own skeleton comes back."""

import itertools

import numpy as np
import pytest
from samples.rotations import matrices

from gva_mi.body.pose import JOINTS, PARENTS
from gva_mi.core.errors import InputError
from gva_mi.readers.motions import MotionOptions, read_motion
from gva_mi.readers.target_body import TargetBody

BODY = TargetBody.read(None)
AS_IT_IS = MotionOptions(fps=30, hands="flat")
CMU = {  # name: parent, offset; arms hang down by 35 degrees, and nothing is as long as the body's
    "Hips": (None, (0, 0, 0)), "LHipJoint": ("Hips", (0, 0, 0)),
    "LeftUpLeg": ("LHipJoint", (1.5, -1.9, 0.6)), "LeftLeg": ("LeftUpLeg", (1.8, -6.5, 0)),
    "LeftFoot": ("LeftLeg", (1.9, -6.6, 0)), "LeftToeBase": ("LeftFoot", (0.1, -0.4, 2.0)),
    "RHipJoint": ("Hips", (0, 0, 0)), "RightUpLeg": ("RHipJoint", (-1.4, -1.8, 0.6)),
    "RightLeg": ("RightUpLeg", (-1.9, -6.6, 0)), "RightFoot": ("RightLeg", (-1.8, -6.5, 0)),
    "RightToeBase": ("RightFoot", (-0.1, -0.4, 2.1)), "LowerBack": ("Hips", (0, 0, 0)),
    "Spine": ("LowerBack", (0, 2, -0.1)), "Spine1": ("Spine", (0, 2.1, -0.1)),
    "Neck": ("Spine1", (0, 0, 0)), "Head": ("Neck", (0, 1.7, 0.1)),
    "LeftShoulder": ("Spine1", (0, 0, 0)), "LeftArm": ("LeftShoulder", (3.3, 0.4, 0)),
    "LeftForeArm": ("LeftArm", (4.1, -2.9, 0)), "LeftHand": ("LeftForeArm", (2.8, -2.0, 0.2)),
    "RightShoulder": ("Spine1", (0, 0, 0)), "RightArm": ("RightShoulder", (-3.2, 0.4, 0)),
    "RightForeArm": ("RightArm", (-4.1, -2.9, 0)), "RightHand": ("RightForeArm", (-2.8, -2.0, 0.2)),
}  # fmt: skip
SAME = {"LeftUpLeg": "left_hip", "LeftLeg": "left_knee", "LeftFoot": "left_ankle",
        "RightUpLeg": "right_hip", "RightLeg": "right_knee", "RightFoot": "right_ankle",
        "LeftArm": "left_shoulder", "LeftForeArm": "left_elbow", "LeftHand": "left_wrist",
        "RightArm": "right_shoulder", "RightForeArm": "right_elbow",
        "RightHand": "right_wrist"}  # fmt: skip


def about(axis, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.tile(np.eye(3), (len(c), 1, 1))
    R[:, i, i], R[:, i, j], R[:, j, i], R[:, j, j] = c, -s, s, c
    return R


def angles(R, order):
    """Degrees (T, 3) about the axes of ``order``, whose product is R."""
    i, j, k = order
    sign = 1 if (j - i) % 3 == 1 else -1
    second = np.arcsin(np.clip(sign * R[:, i, k], -1, 1))
    first = np.arctan2(-sign * R[:, j, k], R[:, k, k])
    third = np.arctan2(-sign * R[:, i, j], R[:, i, i])
    return np.degrees(np.stack([first, second, third], 1))


def write(path, skeleton, turns, root, frame_time=1 / 30):
    """Write joints {name: (parent, offset)} that turn by (T, J, 3, 3), in changing orders."""
    orders = itertools.cycle(itertools.permutations(range(3)))
    names, rows = list(skeleton), []
    path.write_text("HIERARCHY\n" + _joint(names, skeleton, turns, root, rows, orders, names[0]))
    numbers = np.concatenate(rows, 1)
    with path.open("a") as file:
        file.write(f"MOTION\nFrames: {len(root)}\nFrame Time: {frame_time:.7f}\n")
        np.savetxt(file, numbers, "%.6f")
    return path


def _joint(names, skeleton, turns, root, rows, orders, name):
    parent, offset = skeleton[name]
    order, head = next(orders), "JOINT" if parent else "ROOT"
    channels = [f"{'XYZ'[axis]}rotation" for axis in order]
    if not parent:
        rows.append(root[:, [2, 0, 1]])
        channels = ["Zposition", "Xposition", "Yposition", *channels]
    rows.append(angles(turns[:, names.index(name)], order))
    inner = "".join(
        _joint(names, skeleton, turns, root, rows, orders, n) for n in names
        if skeleton[n][0] == name
    ) or "End Site\n{\nOFFSET 0 0 0\n}\n"  # fmt: skip
    text = " ".join(f"{x:.8f}" for x in offset)
    channels = f"CHANNELS {len(channels)} {' '.join(channels)}"
    return f"{head} {name}\n{{\n\tOFFSET {text}\n\t{channels}\n{inner}}}\n"


def chained(skeleton, turns, root):
    """Rotations and places of joints in the world, one by one."""
    names, R, x = list(skeleton), {}, {}
    for k, (name, (parent, offset)) in enumerate(skeleton.items()):
        R[name] = turns[:, k] if parent is None else R[parent] @ turns[:, k]
        x[name] = root if parent is None else x[parent] + R[parent] @ np.array(offset)
    return np.stack([R[n] for n in names], 1), np.stack([x[n] for n in names], 1)


def posed(motion):
    """Joints (T, 55, 3) of the body in the poses of a motion."""
    own = {n: (JOINTS[p] if p >= 0 else None, BODY.joints[k] - BODY.joints[max(p, 0)])
           for k, (n, p) in enumerate(zip(JOINTS, PARENTS, strict=True))}  # fmt: skip
    root = BODY.joints[0] + motion.pose.transl.double().numpy()
    return chained(own, matrices(motion.pose.rotations), root)[1]


def apart(a, b):
    """Largest angle between directions, degrees."""
    a, b = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (a, b))
    return np.degrees(2 * np.arcsin(np.linalg.norm(a - b, axis=-1).max() / 2))


@pytest.fixture(scope="module")
def dance():
    """Rotations (T, J, 3, 3) of any skeleton, up to 40 degrees a joint, and a path."""
    random = np.random.default_rng(7)
    t = np.arange(20)[:, None, None] / 30

    def of(count):
        waves = 0.7 * np.sin(5 * t + 6 * random.random((1, count, 1)))
        return matrices(waves * random.random((1, count, 3))), np.concatenate(
            [t[:, 0], 0.9 + 0.1 * t[:, 0], -t[:, 0]], 1
        )

    return of


def directions_are_kept(motion, names, places):
    found, worst = posed(motion), 0.0
    for name, ours in SAME.items():
        parent = CMU[name][0]
        if parent in SAME:
            theirs = places[:, names.index(name)] - places[:, names.index(parent)]
            bone = found[:, JOINTS.index(ours)] - found[:, JOINTS.index(SAME[parent])]
            worst = max(worst, apart(bone, theirs))
    return worst


def test_the_body_s_own_skeleton_comes_back(tmp_path, dance):
    """All 52 joints of body and hands with their twist, in centimetres, in any order of angles."""
    own = {n: (JOINTS[p] if p >= 0 else None, 100 * (BODY.joints[k] - BODY.joints[max(p, 0)]))
           for k, (n, p) in enumerate(zip(JOINTS, PARENTS, strict=True))}  # fmt: skip
    turns, path = dance(55)
    turns[:, 22:25] = np.eye(3)  # jaw and eyes
    motion = read_motion(write(tmp_path / "own.BVH", own, turns, 100 * path), BODY, AS_IT_IS)
    found = matrices(motion.pose.rotations)
    cosine = (np.einsum("tjab,tjab->tj", found, turns) - 1) / 2
    assert np.degrees(np.arccos(cosine.clip(-1, 1))).max() < 0.1
    assert np.abs(motion.pose.transl.numpy() - (path - path[0])).max() < 1e-4
    assert motion.notes[0].startswith("BVH, 20 frames at 30 a second, y up")
    assert "its unit is taken as 0.01 m" in motion.notes[1]


def test_limbs_of_another_skeleton_keep_their_directions(tmp_path, dance):
    turns, path = dance(len(CMU))
    motion = read_motion(write(tmp_path / "a.bvh", CMU, turns, 18 * path), BODY, AS_IT_IS)
    assert directions_are_kept(motion, list(CMU), chained(CMU, turns, 18 * path)[1]) < 0.1
    assert "the source has no hands; they are flat" in motion.notes
    assert not motion.pose.rotations[:, 25:].any()


def test_a_skeleton_whose_zero_pose_is_nobody(tmp_path, dance):
    """Joints with axes of their own, as LaFAN1's: a frame in which somebody stands takes over."""
    turns, path = dance(len(CMU))
    turns[4] = np.eye(3)  # the T-pose or A-pose is somewhere in the motion
    plain = read_motion(write(tmp_path / "a.bvh", CMU, turns, 18 * path), BODY, AS_IT_IS)
    names = list(CMU)
    own = matrices(np.random.default_rng(2).normal(size=(len(CMU), 3)))
    above = [names.index(parent) if parent else -1 for parent, _ in CMU.values()]
    to = np.stack([own[p].T if p >= 0 else np.eye(3) for p in above])
    other = {n: (p, to[k] @ np.array(x)) for k, (n, (p, x)) in enumerate(CMU.items())}
    source = write(tmp_path / "b.bvh", other, to @ turns @ own, 18 * path)
    found = read_motion(source, BODY, AS_IT_IS)
    assert any(note.endswith("straightest, in 1 frames from 4 to 4") for note in found.notes)
    same = matrices(found.pose.rotations) - matrices(plain.pose.rotations)
    assert np.abs(same).max() < 1e-5
    assert (found.pose.transl - plain.pose.transl).abs().max() < 1e-5


def test_axes_and_calibration(tmp_path, dance):
    """Left-handed axes are mirrored, z may be up, and a first frame of zero angles is no motion."""
    turns, path = dance(len(CMU))
    plain = read_motion(write(tmp_path / "a.bvh", CMU, turns, 18 * path), BODY, AS_IT_IS)
    S = np.diag([-1.0, 1.0, 1.0])
    mirrored = {n: (p, S @ np.array(x)) for n, (p, x) in CMU.items()}
    source = write(tmp_path / "b.bvh", mirrored, S @ turns @ S, 18 * path @ S)
    found = read_motion(source, BODY, AS_IT_IS)
    assert any("left-handed axes" in note for note in found.notes)
    assert np.abs(posed(found) - posed(plain)).max() < 1e-5
    W = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # y becomes z
    tilted = {n: (p, W @ np.array(x)) for n, (p, x) in CMU.items()}
    found = read_motion(write(tmp_path / "c.bvh", tilted, W @ turns @ W.T, 18 * path @ W.T), BODY,
                        AS_IT_IS)  # fmt: skip
    assert "z up" in found.notes[0] and np.abs(posed(found) - posed(plain)).max() < 1e-5
    first = np.concatenate([np.tile(np.eye(3), (1, len(CMU), 1, 1)), turns])
    source = write(tmp_path / "d.bvh", CMU, first, 18 * np.concatenate([0 * path[:1], path]))
    found = read_motion(source, BODY, AS_IT_IS)
    assert len(found.pose) == 20 and np.abs(posed(found) - posed(plain)).max() < 1e-5


def test_damaged_files_are_described(tmp_path, dance, cli):
    turns, path = dance(len(CMU))
    text = write(tmp_path / "a.bvh", CMU, turns, path).read_text()
    for change, words in (
        (lambda x: x.rsplit(maxsplit=9)[0], r"multiple of its 75 channels; it may be cut short"),
        (lambda x: x.partition("MOTION")[0], "has no MOTION with 'Frames:'"),
        (lambda x: x.replace("Frame Time: 0.0", "Frame Time: -0.0"), "must be seconds above 0"),
        (lambda x: x.replace("LeftLeg", "bone_7"), "without a left (hip|knee); expected a person"),
        (lambda x: x.replace("MOTION", "ROOT Two\n{\n}\nMOTION"), "holds several skeletons"),
        (lambda x: x.replace("OFFSET 0.0", "OFFSET nan0.0", 1), "unexpected format .*nan0.0"),
    ):
        (tmp_path / "b.bvh").write_text(change(text))
        with pytest.raises(InputError, match=words):
            read_motion(tmp_path / "b.bvh", BODY, AS_IT_IS)
    (tmp_path / "b.bvh").write_text(text.replace("Frames: 20", "Frames: 21"))
    notes = read_motion(tmp_path / "b.bvh", BODY, AS_IT_IS).notes
    assert "says that it has 21 frames, and has 20" in notes
    folded = {n: (p, np.abs(x)) for n, (p, x) in CMU.items()}
    with pytest.raises(InputError, match="the person stands neither in the pose of zero"):
        read_motion(write(tmp_path / "c.bvh", folded, turns, path), BODY, AS_IT_IS)
    said = cli.works("motion", tmp_path / "a.bvh", tmp_path / "a.npz")
    assert "20 frames at 30 a second, y up; now 16 at 25" in said
