"""Files in exactly the form of each estimator: the person stands where the file says."""

import pickle
import re

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.built_in import BUILT_IN_BODY
from gva_mi.core.errors import InputError
from gva_mi.data.importers.estimator_record import VideoInfo
from gva_mi.data.importers.estimators import read_estimator
from gva_mi.data.importers.lens import rescaled
from gva_mi.data.importers.people import follow

WIDTH, HEIGHT, FRAMES = 64, 48, 5
SMPL, SMPLX = np.array([-0.0018, -0.2233, 0.0282]), np.array([0.0031, -0.3514, 0.0120])
CENTRED = lambda f: np.array([[f, 0, WIDTH / 2], [0, f, HEIGHT / 2], [0, 0, 1]])


def matrices(rotations):
    return roma.rotvec_to_rotmat(torch.as_tensor(rotations, dtype=torch.float64)).numpy()


def of_smpl(rotations):
    """SMPL's 24 joints, (T, 24, 3)."""
    return np.concatenate([rotations[:, :22], np.ones((len(rotations), 2, 3))], axis=1)


def flat(rotations, part):
    return rotations[:, part].reshape(len(rotations), -1)


@pytest.fixture
def prepared(tmp_path, cli, footage):
    """Run the command on a source; returns the folder and what was said."""

    def run(source, *more, kind="auto"):
        given = [*footage[2:], *more] if "--body" in more else [*footage, *more]
        code, said, err = cli("prepare", kind, source, tmp_path / "s", *given)
        assert code == 0, err
        return tmp_path / "s", said

    return run


@pytest.fixture
def refused(tmp_path, cli, footage):
    def run(words, source, *more, kind="auto"):
        code, _, err = cli("prepare", kind, source, tmp_path / "s", *footage, *more)
        assert code == 2 and re.search(words, err) and err.count("\n") <= 2, err
        assert not (tmp_path / "s").exists()

    return run


def dumped(path, value):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(value))
    return path


def test_pymaf_x_writes_batches_of_matrices(tmp_path, seen, prepared, stands):
    rotations, transl = seen
    R = matrices(rotations)
    body = np.concatenate([R[:, :22], np.eye(3) + np.zeros((FRAMES, 2, 3, 3))], axis=1)
    tensor = lambda x: torch.as_tensor(x, dtype=torch.float32)
    batch = lambda rows: {
        "shape": torch.zeros(len(rows), 10), "body_pose": tensor(body[rows]),
        "left_hand_pose": tensor(R[rows, 25:40]), "right_hand_pose": tensor(R[rows, 40:]),
        "jaw_pose": tensor(R[rows, 22:23]), "leye_pose": tensor(R[rows, 23:24]),
        "reye_pose": tensor(R[rows, 24:25]), "expression": torch.zeros(len(rows), 10),
    }  # fmt: skip
    output = {
        "pred_cam": np.ones((FRAMES, 3)), "orig_cam": np.ones((FRAMES, 4)), "orig_cam_t": transl,
        "pose": np.zeros((FRAMES, 72)), "betas": np.zeros((FRAMES, 10)),
        "bboxes": np.zeros((FRAMES, 4)), "frame_ids": np.arange(FRAMES),
        "person_ids": ["p0"] * FRAMES, "smplx_params": [batch([0, 1, 2]), batch([3, 4])],
    }  # fmt: skip
    folder, said = prepared(dumped(tmp_path / "output.pkl", output))
    assert "pymafx, SMPL-X" in said and "no hands" not in said
    stands(folder, rotations, SMPLX + transl, CENTRED(5000), joints=55)
    output["smplx_params"] = output["smplx_params"][:1]
    with pytest.raises(InputError, match="'body_pose' has 3 rows for 5 frame_ids"):
        path = dumped(tmp_path / "output.pkl", output)
        read_estimator("pymafx", path, VideoInfo((WIDTH, HEIGHT)))


@pytest.mark.parametrize("joints", [24, 55])
def test_hybrik_has_a_lens_for_each_box(tmp_path, seen, prepared, stands, joints):
    rotations, transl = seen
    angles = of_smpl(rotations) if joints == 24 else rotations
    wide = np.array([20.0, 24, 28, 32, 36])
    res = {
        "pred_thetas": matrices(angles).reshape(FRAMES, 9 * joints).astype("f4"),
        "pred_betas": np.zeros((FRAMES, 10)), "pred_cam_root": transl, "transl": transl * 0,
        "bbox": np.stack([0 * wide + 3, 0 * wide, wide + 3, wide], axis=1),
        "height": np.full(FRAMES, 2 * HEIGHT), "width": np.full(FRAMES, 2 * WIDTH),
        "img_path": np.array([f"raw_images/walk-2_{k + 1:06d}.png" for k in range(FRAMES)]),
    }  # fmt: skip
    folder, said = prepared(dumped(tmp_path / "res.pk", res), "--first", 1)
    assert f"hybrik, {'SMPL' if joints == 24 else 'SMPL-X'}, 5 frames" in said
    K = np.stack([CENTRED(1000 / 256 * w / 2) for w in wide])
    stands(folder, rotations, transl, K, joints=22 if joints == 24 else 55)


def test_tram_writes_tensors_and_its_camera_above(tmp_path, seen, prepared, refused, stands):
    rotations, transl = seen
    track = {
        "pred_cam": torch.zeros(FRAMES, 3), "pred_pose": torch.zeros(FRAMES, 144),
        "pred_shape": torch.zeros(FRAMES, 10), "frame": torch.arange(FRAMES),
        "pred_rotmat": torch.as_tensor(matrices(of_smpl(rotations)), dtype=torch.float32),
        "pred_trans": torch.as_tensor(transl[:, None], dtype=torch.float32),
    }  # fmt: skip
    (tmp_path / "run/hps").mkdir(parents=True)
    np.save(tmp_path / "run/hps/hps_track_0.npy", track)
    refused("camera.npy: no such file; expected img_focal", tmp_path / "run")
    camera = {"pred_cam_R": np.eye(3), "img_focal": 70.0, "img_center": np.array([30.0, 25.0])}
    np.save(tmp_path / "run/camera.npy", camera)
    folder, said = prepared(tmp_path / "run")
    assert "tram, SMPL" in said
    K = np.array([[70, 0, 30], [0, 70, 25], [0, 0, 1.0]])
    stands(folder, rotations, SMPL + transl, K)


@pytest.mark.parametrize("form", ["frames", "video", "bev"])
def test_romp_and_bev_write_objects_in_npz(tmp_path, seen, prepared, stands, form):
    rotations, transl = seen
    thetas, results = of_smpl(rotations).reshape(FRAMES, 72), {}
    hips = np.array([0.0, -0.09, -0.01])
    for k in range(FRAMES):
        other = k % 2  # another person, before or behind in the list
        place = transl[k] + (SMPL + matrices(rotations[k, 0]) @ hips if form == "bev" else 0)
        pair = np.stack([place, place + [1.5, 0, 1]])
        pick = lambda x, other=other: x[::-1] if other else x
        results[f"{k:08d}"] = {
            "smpl_thetas": pick(np.stack([thetas[k], 0 * thetas[k]])).astype("f4"),
            "smpl_betas": np.zeros((2, 11 if form == "bev" else 10), "f4"),
            "cam": np.ones((2, 3), "f4"), "cam_trans": pick(pair).astype("f4"),
            "center_confs": np.ones(2, "f4"),
        }  # fmt: skip
        if form == "video":
            results[f"{k:08d}"]["track_ids"] = pick(np.array([3, 8]))
    (tmp_path / "out").mkdir()
    for name, result in results.items():
        name += "__2_0.1" if form == "bev" else ""
        if form != "video":
            np.savez(tmp_path / f"out/{name}.npz", results=result)
    if form == "video":
        named = {f"{name}.png": result for name, result in results.items()}
        np.savez(tmp_path / "out/video_results.npz", results=named, sequence_results={})
    person = "3" if form == "video" else "0"
    folder, said = prepared(tmp_path / "out", "--person", person)
    assert "romp, SMPL" in said
    K = CENTRED(443.4 / 512 * WIDTH)
    stands(folder, rotations, SMPL + transl, K)


def test_multi_hmr_writes_lists_of_people(tmp_path, seen, prepared, stands):
    rotations, places = seen
    order = [*range(22), *range(25, 55), 22]
    for k in range(FRAMES):
        tensor = lambda x: torch.as_tensor(x, dtype=torch.float32)
        person = {
            "scores": torch.tensor(0.9), "loc": torch.zeros(2), "transl": torch.zeros(3),
            "transl_pelvis": tensor(places[k][None]), "rotvec": tensor(rotations[k, order]),
            "expression": torch.zeros(10), "shape": torch.zeros(10),
        }  # fmt: skip
        far = person | {"transl_pelvis": tensor(places[k][None] + 3), "rotvec": torch.zeros(53, 3)}
        people = [person] if k == 0 else [far, person]
        dumped(tmp_path / f"out/frame_{k}.pkl", people)
    folder, said = prepared(tmp_path / "out")
    assert "multihmr, SMPL-X" in said and "person 0, " in said
    rotations = rotations.copy()
    rotations[:, 23:25] = 0  # it has no eyes
    K = CENTRED(WIDTH / 2 / np.tan(np.pi / 6))
    stands(folder, rotations, places, K, joints=55)


def smplify_x(folder, seen, hands, body=None):
    rotations, transl = seen
    for k in range(FRAMES):
        row = lambda part, k=k: rotations[k, part].reshape(1, -1).astype("f4")
        result = {
            "camera_rotation": np.eye(3)[None], "camera_translation": transl[k : k + 1],
            "betas": np.zeros((1, 10), "f4"), "global_orient": row(slice(0, 1)),
            "body_pose": row(slice(1, 22)) if body is None else body,
            "left_hand_pose": hands[0][k : k + 1], "right_hand_pose": hands[1][k : k + 1],
            "jaw_pose": row(slice(22, 23)), "leye_pose": row(slice(23, 24)),
            "reye_pose": row(slice(24, 25)), "expression": np.zeros((1, 10), "f4"),
        }  # fmt: skip
        dumped(folder / f"results/img_{k:04d}/000.pkl", result)
    return folder


@pytest.mark.parametrize("count", [6, 12])
def test_smplify_x_bends_fingers_by_components(tmp_path, seen, prepared, refused, stands, count):
    rotations, transl = seen
    random = np.random.default_rng(0)
    hands = [random.normal(0, 0.3, (FRAMES, count)) for _ in "lr"]
    out = smplify_x(tmp_path / "out", seen, hands)
    refused(r"'left_hand_pose' must be \(T, 45\).*--body with the SMPL-X file.*\(5, ", out)
    with np.load(BUILT_IN_BODY) as file:
        body = dict(file)
    np.savez(tmp_path / "body.npz", **body)
    folder, said = prepared(out, "--body", tmp_path / "body.npz")
    assert "smplifyx, SMPL-X" in said
    fingers = [c @ body[f"hands_components{s}"][:count] + body[f"hands_mean{s}"]
               for c, s in zip(hands, "lr", strict=True)]  # fmt: skip
    rotations = rotations.copy()
    rotations[:, 25:] = np.concatenate(fingers, axis=1).reshape(FRAMES, 30, 3)
    stands(folder, rotations, SMPLX + transl, CENTRED(5000), joints=55)


def test_smplify_x_takes_another_lens_and_no_latent_code(tmp_path, seen, prepared, refused, stands):
    rotations, transl = seen
    hands = [flat(rotations, slice(25, 40)), flat(rotations, slice(40, 55))]
    out = smplify_x(tmp_path / "out", seen, hands)
    refused("--focal must be a number above 0 .* pixels, got -1", out, "--focal", -1)
    folder, _ = prepared(out, "--focal", 90)
    stands(folder, rotations, SMPLX + transl, CENTRED(90))
    latent = smplify_x(tmp_path / "latent", seen, hands, body=np.zeros((1, 32), "f4"))
    with pytest.raises(InputError, match="latent code of VPoser"):
        read_estimator("auto", latent, VideoInfo((WIDTH, HEIGHT)))


def parameters(seen, **more):
    rotations, transl = seen
    return {
        "global_orient": flat(rotations, slice(0, 1)), "body_pose": flat(rotations, slice(1, 22)),
        "transl": transl, "betas": np.zeros((1, 10)),
    } | more  # fmt: skip


def test_parameters_in_one_file(tmp_path, seen, prepared, refused, stands):
    """smpl_params.npz of AnimatableGaussians has these names; the lens is in the file or given."""
    rotations, transl = seen
    hands = {"left_hand_pose": flat(rotations, slice(25, 40)), "expression": np.zeros((FRAMES, 10)),
             "right_hand_pose": flat(rotations, slice(40, 55)),
             "jaw_pose": flat(rotations, slice(22, 23))}  # fmt: skip
    np.savez(tmp_path / "smpl_params.npz", **parameters(seen, **hands))
    refused("says no camera.*give --focal", tmp_path / "smpl_params.npz")
    folder, said = prepared(tmp_path / "smpl_params.npz", "--focal", 70)
    assert "parameters, SMPL-X" in said
    stands(folder, rotations, SMPLX + transl, CENTRED(70), joints=23)
    np.savez(tmp_path / "no.npz", **{k: x for k, x in parameters(seen).items() if k != "transl"})
    with pytest.raises(InputError, match=r"no translation; expected transl \(T, 3\)"):
        read_estimator("auto", tmp_path / "no.npz", VideoInfo((WIDTH, HEIGHT), 70))


def test_parameters_a_file_a_frame_as_matrices(tmp_path, seen, prepared, stands):
    """AGORA's form: each (1, J, 3, 3)."""
    rotations, transl = seen
    R = matrices(rotations)
    for k in range(FRAMES):
        frame = {
            "global_orient": R[k : k + 1, :1], "body_pose": R[k : k + 1, 1:22],
            "left_hand_pose": R[k : k + 1, 25:40], "right_hand_pose": R[k : k + 1, 40:],
            "transl": transl[k : k + 1], "betas": np.zeros((1, 10)), "gender": "neutral",
            "K": CENTRED(60 + k),
        }  # fmt: skip
        dumped(tmp_path / f"agora/{k}.pkl", frame)
    folder, _ = prepared(tmp_path / "agora")
    rotations = rotations.copy()
    rotations[:, 22:25] = 0
    K = np.stack([CENTRED(60 + k) for k in range(FRAMES)])
    stands(folder, rotations, SMPLX + transl, K, joints=55)


def test_parameters_of_smpl_with_the_root_repeated(tmp_path, seen, prepared, stands):
    rotations, transl = seen
    body = of_smpl(rotations).reshape(FRAMES, 72)
    np.savez(tmp_path / "p.npz", **parameters(seen, body_pose=body, focal=np.array(70.0)))
    folder, said = prepared(tmp_path / "p.npz")
    assert "parameters, SMPL, " in said
    stands(folder, rotations, SMPL + transl, CENTRED(70))


@pytest.mark.parametrize("name, key", [("transl", "body_scale"), ("translation", "scale")])
def test_a_scaled_body_comes_nearer_instead(tmp_path, seen, prepared, stands, name, key):
    """THuman's form, x = s b + t: it looks the same as b + t / s."""
    rotations, transl = seen
    given = parameters(seen, K=CENTRED(70))
    given.pop("transl")
    np.savez(tmp_path / "p.npz", **given, **{name: transl * 1.25, key: np.array([1.25])})
    folder, _ = prepared(tmp_path / "p.npz")
    stands(folder, rotations, SMPLX + transl, CENTRED(70))


def test_arrays_without_names_and_other_bodies_are_refused(tmp_path, refused):
    np.save(tmp_path / "flat.npy", np.zeros((5, 265)))
    refused(r"an array \(5, 265\) without names.*save them by name", tmp_path / "flat.npy")
    mhr = [{"pred_vertices": np.zeros((9, 3)), "pred_cam_t": np.zeros(3), "focal_length": 900.0,
            "body_pose_params": np.zeros(133), "shape_params": np.zeros(45)}]  # fmt: skip
    words = "parameters of MHR, as SAM 3D Body writes"
    refused(words, dumped(tmp_path / "sam.pkl", mhr))
    refused(words, dumped(tmp_path / "nested.pkl", {"outputs": mhr}))
    refused(words, dumped(tmp_path / "frames.pkl", {"0.jpg": {"people": mhr}}))
    (tmp_path / "out").mkdir()
    for k in range(2):
        np.savez(tmp_path / f"out/{k:04}.npz", **mhr[0])
    refused("out: holds " + words, tmp_path / "out")
    np.savez(tmp_path / "out/0000.npz", data=np.array(mhr, object))
    refused("out: holds " + words, tmp_path / "out")


def test_a_damaged_file_is_refused_in_one_sentence(tmp_path, refused):
    res = {"pred_thetas": np.zeros((1, 7)), "pred_cam_root": 0, "bbox": 0, "img_path": ["x"]}
    refused("\\(of the kind hybrik\\): of another form", dumped(tmp_path / "r.pk", res))


def test_the_nearest_person_keeps_the_name():
    a, b = np.array([0.0, 0, 4]), np.array([0.6, 0, 4])
    assert follow([[a], [b, a], [a, b], [], [b + 0.1]]) == [
        ["0"],
        ["1", "0"],
        ["0", "1"],
        [],
        ["1"],
    ]
    assert follow([[a], [a + 5]]) == [["0"], ["1"]]


def test_a_lens_of_another_size_is_scaled():
    K = rescaled("x", CENTRED(10), (WIDTH, HEIGHT), (2 * WIDTH, 2 * HEIGHT))
    assert np.allclose(K, [[20, 0, WIDTH], [0, 20, HEIGHT], [0, 0, 1]])
    with pytest.raises(InputError, match="expected the same shape"):
        rescaled("x", CENTRED(10), (0, 0), (WIDTH, HEIGHT))
