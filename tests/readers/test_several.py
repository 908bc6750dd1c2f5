"""Several people, or several frames, in one file: each is found, and moves as in a file alone."""

import pickle

import numpy as np
import pytest
from samples.estimates import CENTRED, of_smpl
from samples.rotations import matrices, same

from gva_mi.core.errors import InputError
from gva_mi.readers.estimator_layouts import VideoInfo
from gva_mi.readers.estimators import read_estimator
from gva_mi.readers.motions import MotionOptions, read_motion
from gva_mi.readers.target_body import TargetBody

T = 7
STEPS = (0.03, 0.06)  # metres a frame, of two people


@pytest.fixture(scope="module")
def target():
    return TargetBody.read(None)


@pytest.fixture
def pair(walk):
    """Rotations (2, T, 55, 3) and places (2, T, 3) of two people."""
    rotations, _ = walk(2 * T)
    places = [np.outer(np.arange(T), [step, 0, 0]) + [0, 0.9, step] for step in STEPS]
    return np.stack([rotations[:T], rotations[T:]]), np.stack(places)


def parts(rotations, places):
    """One person by AMASS's names, or people on the first axis."""
    flat = lambda part: rotations[..., part, :].reshape(*rotations.shape[:-2], -1)
    return {"root_orient": flat(slice(0, 1)), "pose_body": flat(slice(1, 22)), "trans": places}


def rows(rotations):
    return of_smpl(rotations).reshape(T, 72)


def in_lists(rotations, places):
    """3DPW's file, with its copies of 60 frames a second and its camera."""
    poses = [rows(x) for x in rotations]
    return {
        "poses": poses, "trans": list(places), "betas": [np.zeros(300)] * 2, "genders": ["f", "m"],
        "poses_60Hz": [x.repeat(2, 0) for x in poses], "cam_poses": np.tile(np.eye(4), (T, 1, 1)),
        "cam_intrinsics": np.eye(3), "sequence": "street", "fps": 30,
    }  # fmt: skip


def in_axes(rotations, places):
    """SLAHMR's world_results.npz."""
    of_cameras = {"cam_R": np.tile(np.eye(3), (2, T, 1, 1)), "intrins": np.ones(4), "fps": 30}
    return parts(rotations, places) | {"betas": np.zeros((2, 16))} | of_cameras


def by_person(rotations, places):
    """InterHuman's file: the frame rate lies beside the people."""
    people = {f"person{k + 1}": parts(rotations[k], places[k]) for k in range(2)}
    return {"mocap_framerate": 30.0, "frames": T, **people}


def by_clip(rotations, places):
    """PHC's clips by name."""
    clip = lambda r, x: {"pose_aa": rows(r), "trans_orig": x, "beta": np.zeros(16), "fps": 30}
    return {f"0-a{k}": clip(rotations[k], places[k]) for k in range(2)}


def in_a_list(rotations, places):
    return [parts(r, x) | {"fps": 30} for r, x in zip(rotations, places, strict=True)]


NAMES = {in_lists: "01", in_axes: "01", by_person: ("person1", "person2"),
         by_clip: ("0-a0", "0-a1"), in_a_list: "01"}  # fmt: skip


@pytest.mark.parametrize("form", NAMES)
def test_each_of_several_people_moves_as_alone(form, pair, tmp_path, target):
    path = tmp_path / "people.pkl"
    path.write_bytes(pickle.dumps(form(*pair)))
    for k, name in enumerate(NAMES[form]):
        options = MotionOptions(fps=30, hands="flat", person=name)
        found = read_motion(path, target, options)
        assert same(found.pose.rotations[:, :22], pair[0][k, :, :22])
        path_length = np.linalg.norm(np.diff(found.pose.transl.numpy(), axis=0), axis=1).sum()
        assert abs(path_length - STEPS[k] * (T - 1)) < 1e-5
    found = read_motion(path, target, MotionOptions(fps=30))
    first, second = NAMES[form]
    said = f"person {first}, seen longest of {first} (7 frames), {second} (7 frames)"
    assert any(said in note for note in found.notes)
    with pytest.raises(InputError, match=f"has no person 'x'; it has {first} .7 frames., {second}"):
        read_motion(path, target, MotionOptions(person="x"))


def frames(rotations, places, key, left_out=()):
    person = parts(rotations, places) | {"K": np.tile(CENTRED(50), (T, 1, 1))}
    return {key(k): {name: x[k] for name, x in person.items()} for k in range(T)
            if k not in left_out}  # fmt: skip


KEYS = {"pictures": lambda k: f"{k:06d}.jpg", "numbers": int, "text": str, "a list": None}


@pytest.mark.parametrize("left_out", [(), (4,), (0, 1)])
@pytest.mark.parametrize("keys", KEYS)
def test_a_dictionary_by_frames_is_read_as_a_folder_is(keys, left_out, pair, tmp_path, target):
    rotations, places = pair[0][0], pair[1][0] + [0, 0, 4]
    by_name = frames(rotations, places, KEYS["pictures"], left_out)
    (tmp_path / "folder").mkdir()
    for name, frame in by_name.items():
        np.savez(tmp_path / f"folder/{name[:-4]}.npz", **{k: x[None] for k, x in frame.items()})
    found = frames(rotations, places, KEYS[keys] or int, left_out)
    if keys == "a list":  # None: nobody was found
        found = [found.get(k) for k in range(T)]
    (tmp_path / "found.pkl").write_bytes(pickle.dumps(found))
    wanted = [k for k in range(T) if k not in left_out]
    for name in ("folder", "found.pkl"):
        kind, (track,) = read_estimator("auto", tmp_path / name, VideoInfo((64, 48)))
        assert kind == "parameters" and track.frames.tolist() == wanted
        assert np.allclose(track.rotations[:, :22], rotations[wanted, :22])
        steps = track.places - track.places[0]
        assert np.allclose(steps, (places - places[wanted[0]])[wanted])
        options = MotionOptions(fps=30, source_fps=30, hands="flat", up="y")
        motion = read_motion(tmp_path / name, target, options)
        assert len(motion.pose) == T - wanted[0]
        gap = any("frames without numbers, interpolated: 4" in note for note in motion.notes)
        assert gap == (left_out == (4,))


def test_a_root_in_another_array(pair):
    """EMDB's names; EasyMocap's Rh beside 69 numbers; a row whose root is zero, as InstantAvatar's
    fits have it."""
    from gva_mi.readers.body_arrays import find_body

    rotations = pair[0][0]
    root, body = rotations[:, 0], of_smpl(rotations)[:, 1:].reshape(T, 69)
    zero = np.concatenate([0 * root, body], 1)
    for found in (
        {"smpl": {"poses_root": root, "poses_body": body, "trans": pair[1][0]}},
        {"poses": body, "Rh": root, "Th": pair[1][0]},
        {"poses": zero, "global_orient": root},
        {"poses": zero, "global_orient": matrices(root)},
        {"body_pose": matrices(of_smpl(rotations)[:, 1:]), "global_orient": matrices(root)},
    ):
        turns = find_body("x", found).rotations[:, :22]
        assert np.abs(matrices(turns) - matrices(rotations[:, :22])).max() < 1e-9
    other = {"poses": np.concatenate([root, body], 1), "global_orient": root + 0.2}
    assert find_body("x", other).unused == ("global_orient",)


@pytest.mark.parametrize("shape", [(63,), (T, 63), (T, 21, 3), (T, 69), (T, 23, 3, 3)])
@pytest.mark.parametrize("name", ["pose_body", "poses"])
def test_a_missing_root_is_the_cause_that_is_named(name, shape):
    from gva_mi.readers.body_arrays import find_body

    with pytest.raises(InputError, match=f"'{name}' .* lacks the root's rotation.* root_orient"):
        find_body("x", {name: np.zeros(shape)})


def test_smpls_hands_of_one_joint_are_left_out(pair):
    """As ARAH writes them: the body is SMPL, as a row of 72 numbers is."""
    from gva_mi.readers.body_arrays import find_body

    person = parts(pair[0][0], pair[1][0])
    of_both = {"pose_hand": np.full((T, 6), 0.1)}
    of_each = {f"{side}_hand_pose": np.full((T, 1, 3), 0.1) for side in ("left", "right")}
    for hands in (of_both, of_each):
        found = find_body("x", person | hands)
        assert found.form == "SMPL" and not found.has_hands and not found.unused
        assert np.array_equal(found.rotations[:, :22], pair[0][0][:, :22])
        assert not found.rotations[:, 22:].any()


def test_matrices_of_zeros_are_eyes_that_rest(pair):
    from gva_mi.readers.body_arrays import find_body

    person, turn = parts(pair[0][0], pair[1][0]), matrices(np.full((T, 1, 3), 0.2))
    turn[2:] = 0  # estimated in two frames
    found = find_body("x", person | {"leye_pose": np.zeros((T, 1, 3, 3)), "reye_pose": turn})
    assert not found.rotations[:, 23].any() and not found.rotations[2:, 24].any()
    assert np.allclose(found.rotations[:2, 24], 0.2)
    with pytest.raises(InputError, match="must hold rotation matrices"):
        find_body("x", person | {"pose_body": np.zeros((T, 21, 3, 3))})
