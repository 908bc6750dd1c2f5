"""A body's arrays under public names and in public places are found, or named as not used."""

import gzip
import pickle

import numpy as np
import pytest
from samples.rotations import matrices

from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.core.errors import InputError
from gva_mi.readers.body_arrays import find_body
from gva_mi.readers.motions import MotionOptions, read_motion
from gva_mi.readers.target_body import TargetBody
from gva_mi.readers.track import make_track

T = 6


@pytest.fixture
def motion(walk):
    """Rotations, and their parts flat by SMPL-X's names, without translation."""
    rotations, _ = walk(T)
    part = lambda a, b: rotations[:, a:b].reshape(T, -1)
    named = {"global_orient": part(0, 1), "body_pose": part(1, 22), "jaw_pose": part(22, 23),
             "left_hand_pose": part(25, 40), "right_hand_pose": part(40, 55)}  # fmt: skip
    return rotations, named


def renamed(named, **names):
    return {names.get(name, name): x for name, x in named.items()}


SPELLED = {
    "AMASS's": dict(global_orient="root_orient", body_pose="pose_body", jaw_pose="pose_jaw",
                    left_hand_pose="pose_lhand", right_hand_pose="pose_rhand"),
    "OSX's": dict(global_orient="root_pose", left_hand_pose="lhand_pose",
                  right_hand_pose="rhand_pose"),
    "a network's": {name: f"smplx_{name}" for name in (
        "global_orient", "body_pose", "jaw_pose", "left_hand_pose", "right_hand_pose")},
    "camel case": dict(global_orient="globalOrient", body_pose="bodyPose", jaw_pose="jawPose",
                       left_hand_pose="leftHandPose", right_hand_pose="rightHandPose"),
    "mixed": dict(body_pose="pose_body", left_hand_pose="left_hand", right_hand_pose="right_hand"),
}  # fmt: skip


@pytest.mark.parametrize("name", SPELLED)
def test_parts_under_other_names_are_the_same_joints(name, motion):
    rotations, named = motion
    found = find_body("x", renamed(named, **SPELLED[name]))
    assert found.form == "SMPL-X" and found.has_hands and not found.unused
    for joints in (slice(0, 23), slice(25, 55)):
        assert np.array_equal(found.rotations[:, joints], rotations[:, joints])


def test_the_root_may_lie_in_the_bodys_pose_in_any_form(motion):
    """As GaussianAvatar saves it: SMPL's 24 joints, the root first, and no global_orient."""
    rotations, _ = motion
    smpl = np.concatenate([rotations[:, :22], np.ones((T, 2, 3))], axis=1)
    for body in (smpl.reshape(T, 72), smpl, matrices(smpl), matrices(smpl).reshape(T, 216),
                 rotations[:, :22].reshape(T, 66)):  # fmt: skip
        found = find_body("x", {"body_pose": body, "beta": np.ones((1, 10))})
        assert np.abs(matrices(found.rotations[:, :22]) - matrices(rotations[:, :22])).max() < 1e-9
        assert found.form == "SMPL" and found.betas.shape == (10,)
    for whole, root in (("poses", smpl[:, 1:].reshape(T, 69)), ("pose", rotations[:, 1:22])):
        found = find_body("x", {whole: root, "global_orient": rotations[:, 0]})
        assert np.array_equal(found.rotations[:, :22], rotations[:, :22])


@pytest.mark.parametrize("joints, form", [(22, "SMPL-X"), (24, "SMPL")])
def test_hands_and_jaw_may_lie_beside_a_whole_pose(joints, form, motion):
    rotations, named = motion
    whole = np.concatenate([rotations[:, :22], np.ones((T, joints - 22, 3))], axis=1)
    parts = {name: named[name] for name in ("jaw_pose", "left_hand_pose", "right_hand_pose")}
    found = find_body("x", {"bodyPose": whole, **parts})
    assert found.form == form and found.has_hands and not found.unused
    for part in (slice(0, 23), slice(25, 55)):
        assert np.array_equal(found.rotations[:, part], rotations[:, part])


def test_parts_that_a_whole_pose_repeats_are_not_called_unused(motion):
    """AMASS of SMPL-X and GRAB hold both, GRAB with hands as components."""
    rotations, named = motion
    whole = {"fullpose": rotations.reshape(T, 165), **named, "right_hand_pose": np.ones((T, 24))}
    found = find_body("x", whole)
    assert np.array_equal(found.rotations, rotations) and not found.unused


@pytest.mark.parametrize("change, words", [
    (lambda x: {**x, "transl": np.zeros((3, T))}, r"'transl' must be \(6, 3\), got \(3, 6\)"),
    (lambda x: {**x, "body_pose": x["body_pose"].T}, r"'body_pose' must be \(6, 63\)"),
    (lambda x: {name: np.degrees(3 * part) for name, part in x.items()}, "rotations in degrees"),
    (lambda x: {"poses": np.zeros((T, 22, 6))}, "132 numbers a frame; expected axis-angle"),
    (lambda x: {"poses": np.zeros((T, 24, 4))}, "96 numbers a frame; .* no quaternions"),
])  # fmt: skip
def test_rows_for_columns_and_other_rotations_are_refused(change, words, motion):
    with pytest.raises(InputError, match=words):
        find_body("x", change(motion[1]))


def test_axes_of_length_1_do_not_count(motion):
    """A batch of one motion, and a list of single people as NLF returns it."""
    rotations, _ = motion
    smpl = np.concatenate([rotations[:, :22], np.zeros((T, 2, 3))], axis=1).reshape(T, 72)
    for pose in (smpl[None], smpl[:, None], matrices(smpl.reshape(T, 1, 24, 3))):
        found = find_body("x", {"pose": pose, "trans": np.ones((T, 1, 3))})
        assert np.allclose(matrices(found.rotations[:, :22]), matrices(rotations[:, :22]))


def test_parameters_may_lie_in_a_dictionary_of_their_own(motion):
    rotations, named = motion
    packed = np.empty((), object)
    packed[()] = named
    for found in (
        {"params": named, "gender": "neutral"}, {"smplx": packed, "fps": 30},
        {"result": {"smpl_params": named}, "joints": np.zeros((T, 144, 2))},
    ):  # fmt: skip
        assert np.array_equal(find_body("x", found).rotations[:, :22], rotations[:, :22])
    with pytest.raises(InputError, match="holds no poses of one person.*found: first, second"):
        find_body("x", {"first": named, "second": named})


def test_what_is_not_used_is_named_and_a_missing_place_is_said(motion):
    _, named = motion
    more = {"dmpls": np.zeros((T, 8)), "markers": np.zeros((T, 41, 3)), "K": np.eye(3),
            "gender": "male", "fps": 30.0, "leye_pose": np.zeros((T, 3))}  # fmt: skip
    track = make_track("x", "0", None, named | more, np.eye(3))
    assert track.notes == (
        "the source has no translation: the person stays in place",
        "arrays of the source that are not used: dmpls, markers",
    )


@pytest.mark.parametrize("name", [
    "global_body_translation", "smpl_trans", "root_trans", "bodyTranslation", "tran", "Th",
])  # fmt: skip
def test_translations_under_other_names_move_the_body(name, motion):
    _, named = motion
    moves = np.outer(np.arange(T), [0.1, 0, 0])
    found = find_body("x", named | {name: moves, "body_scale": np.array([0.5])})
    assert np.allclose(found.transl, moves / 0.5) and not found.unused


def test_easymocaps_turn_is_about_the_origin(motion):
    """x = R(Rh) b + Th, also of the pelvis p."""
    rotations, _ = motion
    Rh, Th = rotations[:, 5], rotations[:, 7] + 1
    poses = rotations.reshape(T, -1).copy()
    poses[:, :3] = 0
    track = make_track("x", "0", None, {"poses": poses, "Rh": Rh, "Th": Th}, np.eye(3))
    pelvis = np.array([0.0031, -0.3514, 0.0120])
    assert np.allclose(track.places, matrices(Rh) @ pelvis + Th)
    assert np.allclose(matrices(track.rotations[:, 0]), matrices(Rh)) and not track.notes


def body_of_smplx(path):
    """The built-in body with SMPL-X's pelvis: its file is taken for SMPL-X."""
    with np.load(BUILT_IN_BODY) as arrays:
        moved = arrays["v_template"] + np.array([0.0031, -0.3514, 0.0120])
        np.savez(path, **{**arrays, "v_template": moved})
    return path


@pytest.mark.parametrize("name", ["expression", "expressions", "expr", "face_expr"])
def test_the_face_is_kept_for_smplx_and_named_for_other_bodies(name, tmp_path, motion):
    _, named = motion
    face = np.sin(np.arange(T * 50.0)).reshape(T, 50)
    np.savez(tmp_path / "m.npz", **named, **{name: face}, fps=30)
    options = MotionOptions(fps=30)
    own = TargetBody.read(body_of_smplx(tmp_path / "body.npz"))
    kept = read_motion(tmp_path / "m.npz", own, options)
    assert np.allclose(kept.pose.expression, face[:, :10], atol=1e-6)
    assert any("the first 10 of 50 coefficients of the expression are" in n for n in kept.notes)
    other = read_motion(tmp_path / "m.npz", TargetBody.read(None), options)
    assert not other.pose.expression.any()
    assert any("the face's expression is left out: coefficients of SMPL-X" in n
               for n in other.notes)  # fmt: skip


ROWS = {(72,): None, (165,): None, (156,): None, (24, 3): None, (52, 3): None, (55, 3): None,
    (24, 3, 3): None, (322,): "any parameters in any order",
    (22, 3): "legs change their lengths or differ"}  # fmt: skip


@pytest.mark.parametrize("shape", ROWS, ids=str)
def test_arrays_without_names_are_poses_or_named_by_their_shape(shape, tmp_path):
    rows = (
        np.zeros((4, *shape)) if shape[-2:] != (3, 3) else np.broadcast_to(np.eye(3), (4, *shape))
    )
    np.save(tmp_path / "a.npy", rows)
    read = lambda: read_motion(
        tmp_path / "a.npy", TargetBody.read(None), MotionOptions(fps=30, source_fps=30)
    )
    if ROWS[shape] is None:
        assert len(read().pose) == 4
    else:
        with pytest.raises(InputError, match=f"a.npy: .*{ROWS[shape]}"):
            read()


OTHERS = {
    "m.npz": (b"HIERARCHY\nROOT Hips\n", "a .bvh, the motion of a skeleton"),
    "walk.fbx": (b"Kaydara FBX Binary  \0\x1a\0" + bytes(60), "an .fbx, a scene: export"),
    "poses.npz": (b"version https://git-lfs.github.com/spec/v1\noid sha256:0", "Git LFS pointer"),
    "m.pkl": (b"<!DOCTYPE html><html>", "a web page"),
    "m.mat": (b"MATLAB 5.0 MAT-file", "scipy.io.loadmat"),
    "m.npy": (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
    "a.spz": (b"NGSP\4\0\0\0" + bytes(60), "an .spz of Gaussians, of a version without gzip"),
    "b.spz": (gzip.compress(b"NGSP\3\0\0\0"), "compressed by gzip, such as an .spz of Gaussians"),
    "a.glb": (b"glTF\2\0\0\0" + bytes(60), "a .glb, a scene: export its skeleton's motion"),
    "b.glb": (b"glTF\2\0\0\0" + bytes(8) + b'{"extensionsUsed":["KHR_gaussian_splatting"]}',
              "Gaussians by glTF's KHR_gaussian_splatting"),
    "a.gltf": (b'{"asset": {}, "extensionsUsed": ["KHR_gaussian_splatting"]}',
               "Gaussians by glTF's KHR_gaussian_splatting"),
    "a.ply": (b"ply\nformat ascii 1.0\n", "a .ply of points, a mesh or Gaussians"),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_other_containers_are_named(name, tmp_path):
    content, words = OTHERS[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=f"{name}: .*{words}") as caught:
        read_motion(tmp_path / name, TargetBody.read(None), MotionOptions())
    assert "load key" not in str(caught.value)


def test_arrays_of_a_subclass_are_plain_arrays(tmp_path, walk):
    """trimesh's TrackedArray, which ICON's fits of THuman hold, and numpy's own."""
    rotations, transl = walk(4)
    np.save(tmp_path / "mapped.npy", transl)
    mapped = np.load(tmp_path / "mapped.npy", mmap_mode="r")
    found = {"poses": rotations.reshape(4, 165), "trans": mapped, "fps": 30}
    whole = pickle.dumps(found, protocol=2)
    assert b"memmap" in whole
    tracked = whole.replace(b"cnumpy\nmemmap\n", b"ctrimesh.caching\nTrackedArray\n")
    assert tracked != whole
    for data in (whole, tracked):
        (tmp_path / "m.pkl").write_bytes(data)
        read = read_motion(tmp_path / "m.pkl", TargetBody.read(None), MotionOptions(fps=30))
        assert np.allclose(read.pose.transl, transl, atol=1e-6)


def test_a_place_in_other_units_is_doubted(tmp_path, motion):
    path = np.outer(np.arange(T), [40.0, 0, 0])  # 4 cm a frame, in millimetres
    for scale, doubts in ((0.001, 0), (1, 1)):
        np.savez(tmp_path / "m.npz", **motion[1], trans=scale * path, fps=30)
        notes = read_motion(tmp_path / "m.npz", TargetBody.read(None), MotionOptions(fps=30)).notes
        assert sum("doubtful: the pelvis goes 1200.0 m in a second" in n for n in notes) == doubts
