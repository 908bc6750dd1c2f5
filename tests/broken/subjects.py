"""Ways to break a subject's folder by hand, by name: ``SUBJECTS[name](folder)`` changes it."""

import os
import shutil
import struct
import zlib

import numpy as np

NAN, INF = float("nan"), float("inf")


def arrays(path):
    with np.load(path) as file:
        return dict(file)


def with_arrays(path, **changes):
    """Change arrays of an .npz: functions of them, other values, or None for none."""

    def change(folder):
        found = arrays(folder / path)
        for name, value in changes.items():
            other = value(found[name]) if callable(value) else value
            if other is None:
                del found[name]
            else:
                found[name] = np.asarray(other)
        np.savez(folder / path, **found)

    return change


def text(path, content):
    def change(folder):
        (folder / path).parent.mkdir(exist_ok=True, parents=True)
        (folder / path).write_bytes(content.encode() if isinstance(content, str) else content)

    return change


def gone(path):
    def change(folder):
        whole = folder / path
        shutil.rmtree(whole) if whole.is_dir() else whole.unlink()

    return change


def a_folder(path):
    def change(folder):
        (folder / path).unlink(missing_ok=True)
        (folder / path).mkdir(parents=True)

    return change


def cut(path, share=0.5):
    def change(folder):
        data = (folder / path).read_bytes()
        (folder / path).write_bytes(data[: int(share * len(data))])

    return change


def moved(path, to):
    return lambda folder: (folder / path).rename(folder / to)


def picture(path, size=(48, 48), mode="RGB", value=128, form=None):
    def change(folder):
        from PIL import Image

        Image.new(mode, size, value).save(folder / path, form)

    return change


def to_npy(k, change):
    """A mask as an array, of another kind."""

    def write(folder):
        from PIL import Image

        path = folder / f"masks/{k:06d}.png"
        mask = np.asarray(Image.open(path)) / np.float32(255)
        path.unlink()
        np.save(path.with_suffix(".npy"), change(mask))

    return write


def each_mask(change):
    def write(folder):
        from PIL import Image

        for path in (folder / "masks").glob("*.png"):
            Image.fromarray(change(np.asarray(Image.open(path)))).save(path)

    return write


def claims(width, height):
    """A .png of one pixel whose head says otherwise."""
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))


def loop(path):
    def change(folder):
        (folder / path).unlink(missing_ok=True)
        os.symlink(folder / path, folder / path)

    return change


def per_frame(x, count=6):
    return np.repeat(np.asarray(x)[None], count, axis=0)


def at(x, index, value):
    x = np.array(x, np.float64)
    x[index] = value
    return x


CAMERAS = {
    "width is an array": with_arrays("cameras.npz", width=[48, 48]),
    "width is text": with_arrays("cameras.npz", width="48"),
    "width is NaN": with_arrays("cameras.npz", width=NAN),
    "width is negative": with_arrays("cameras.npz", width=-48),
    "width is zero": with_arrays("cameras.npz", width=0),
    "width is half a pixel": with_arrays("cameras.npz", width=48.5),
    "width is enormous": with_arrays("cameras.npz", width=10**9),
    "width is another": with_arrays("cameras.npz", width=47),
    "height is an array of none": with_arrays("cameras.npz", height=np.zeros(0)),
    "height is complex": with_arrays("cameras.npz", height=48j),
    "height is missing": with_arrays("cameras.npz", height=None),
    "K is of no frame": with_arrays("cameras.npz", K=np.zeros((0, 3, 3))),
    "K has four rows": with_arrays("cameras.npz", K=np.eye(4)),
    "K is flat": with_arrays("cameras.npz", K=lambda K: K.reshape(-1)),
    "K is of text": with_arrays("cameras.npz", K=np.full((3, 3), "a")),
    "K is of too many frames": with_arrays("cameras.npz", K=lambda K: per_frame(K, 9)),
    "K has a NaN": with_arrays("cameras.npz", K=lambda K: at(K, (0, 0), NAN)),
    "K has no focal length": with_arrays("cameras.npz", K=lambda K: at(K, (0, 0), 0)),
    "K has a negative focal length": with_arrays("cameras.npz", K=lambda K: at(K, (1, 1), -9)),
    "K is not normalised": with_arrays("cameras.npz", K=lambda K: 2 * K),
    "K has skew": with_arrays("cameras.npz", K=lambda K: at(K, (0, 1), 30.0)),
    "K has a bad last row": with_arrays("cameras.npz", K=lambda K: at(K, (2, 0), 1.0)),
    "K is complex": with_arrays("cameras.npz", K=lambda K: K + 1j),
    "K has a focal length of 1e300": with_arrays("cameras.npz", K=lambda K: at(K, (0, 0), 1e300)),
    "K looks far aside": with_arrays("cameras.npz", K=lambda K: at(K, (0, 2), 1e9)),
    "K is missing": with_arrays("cameras.npz", K=None),
    "T is of another count": with_arrays("cameras.npz", T_camera_world=lambda T: per_frame(T, 4)),
    "T has a bad last row": with_arrays("cameras.npz", T_camera_world=lambda T: at(T, (3, 3), 2)),
    "T is mirrored": with_arrays(
        "cameras.npz", T_camera_world=lambda T: np.diag([-1.0, 1, 1, 1]) @ T
    ),
    "T is scaled": with_arrays("cameras.npz", T_camera_world=lambda T: 2 * T),
    "T is zero": with_arrays("cameras.npz", T_camera_world=np.zeros((4, 4))),
    "T is infinite": with_arrays("cameras.npz", T_camera_world=lambda T: at(T, (0, 3), INF)),
    "T is inverted": with_arrays("cameras.npz", T_camera_world=np.linalg.inv),
    "T is 3 x 4": with_arrays("cameras.npz", T_camera_world=lambda T: T[:3]),
    "T is missing": with_arrays("cameras.npz", T_camera_world=None),
    "cameras are cut": cut("cameras.npz"),
    "cameras are missing": gone("cameras.npz"),
    "cameras are a folder": lambda folder: (gone("cameras.npz")(folder),
                                            a_folder("cameras.npz")(folder)),
    "cameras are empty": text("cameras.npz", ""),
    "cameras are text": text("cameras.npz", "K = 3"),
    "cameras are a link to themselves": loop("cameras.npz"),
    "cameras are a .npy": lambda folder: (
        np.save(folder / "a.npy", np.eye(3)), (folder / "a.npy").replace(folder / "cameras.npz")
    ),
}  # fmt: skip
POSES = {
    "body_pose is short": with_arrays("poses.npz", body_pose=lambda x: x[:, :60]),
    "body_pose is of fewer frames": with_arrays("poses.npz", body_pose=lambda x: x[:5]),
    "body_pose is of text": with_arrays("poses.npz", body_pose=lambda x: x.astype(str)),
    "body_pose has a NaN": with_arrays("poses.npz", body_pose=lambda x: at(x, (2, 5), NAN)),
    "body_pose is enormous": with_arrays("poses.npz", body_pose=lambda x: x + 1e30),
    "body_pose is missing": with_arrays("poses.npz", body_pose=None),
    "body_pose is of objects": with_arrays("poses.npz", body_pose=np.array([{}] * 6, object)),
    "body_pose is complex": with_arrays("poses.npz", body_pose=lambda x: x + 1j),
    "transl is flat": with_arrays("poses.npz", transl=lambda x: x.ravel()),
    "transl is far away": with_arrays("poses.npz", transl=lambda x: x + 1e9),
    "transl is infinite": with_arrays("poses.npz", transl=lambda x: x + INF),
    "transl is behind the camera": with_arrays("poses.npz", transl=lambda x: x + [0, 0, 9]),
    "transl is in millimetres": with_arrays("poses.npz", transl=lambda x: 1000 * x + 700),
    "betas are a table": with_arrays("poses.npz", betas=np.zeros((6, 10))),
    "betas are none": with_arrays("poses.npz", betas=np.zeros(0)),
    "betas are 300": with_arrays("poses.npz", betas=np.zeros(300)),
    "betas are huge": with_arrays("poses.npz", betas=np.full(10, 1e6)),
    "betas have a NaN": with_arrays("poses.npz", betas=np.full(10, NAN)),
    "stage is text": with_arrays("poses.npz", stage="one"),
    "no pose at all": lambda folder: np.savez(
        folder / "poses.npz", **{k: x[:0] if x.ndim > 1 else x
                                 for k, x in arrays(folder / "poses.npz").items()}),
    "poses of one frame": lambda folder: np.savez(
        folder / "poses.npz", **{k: x[:1] if x.ndim > 1 else x
                                 for k, x in arrays(folder / "poses.npz").items()}),
    "poses are cut": cut("poses.npz", 0.9),
    "poses are missing": gone("poses.npz"),
    "poses are those of a picture": lambda folder: shutil.copy(
        folder / "frames/000000.png", folder / "poses.npz"),
    "focal is of text": with_arrays("poses.npz", focal="a"),
    "focal is zero": with_arrays("poses.npz", focal=0.0),
    "focal is two": with_arrays("poses.npz", focal=[1.0, 1.0]),
    "offsets are of another body": with_arrays("poses.npz", offsets=np.zeros((7, 3))),
}  # fmt: skip
SPLITS = {
    "splits are a folder": lambda folder: (gone("splits.json")(folder),
                                           a_folder("splits.json")(folder)),
    "splits are deeply nested": text("splits.json", "[" * 100_000),
    "splits are infinite": text("splits.json", '{"train": [Infinity], "test": []}'),
    "splits are NaN": text("splits.json", '{"train": [NaN], "test": []}'),
    "splits are of no train frame": text("splits.json", '{"train": [], "test": [1]}'),
    "splits are of a frame that is not there": text("splits.json", '{"train": [99], "test": []}'),
    "splits are negative": text("splits.json", '{"train": [-1], "test": []}'),
    "splits are both": text("splits.json", '{"train": [0, 1], "test": [1]}'),
    "splits name a frame twice": text("splits.json", '{"train": [0, 0, 1], "test": [3]}'),
    "splits are of half a frame": text("splits.json", '{"train": [0.5], "test": []}'),
    "splits are of text": text("splits.json", '{"train": "all", "test": []}'),
    "splits are text with numbers": text("splits.json", '{"train": ["0"], "test": ["1"]}'),
    "splits are a list": text("splits.json", "[1, 2]"),
    "splits lack the test": text("splits.json", '{"train": [0]}'),
    "splits are null": text("splits.json", "null"),
    "splits are huge": text("splits.json", '{"train": [1' + 5000 * "0" + '], "test": []}'),
    "splits are no text": text("splits.json", b"\xff\xfe\x00"),
    "splits are cut": cut("splits.json"),
    "all train frames are absent": lambda folder: [
        gone(f"masks/{k:06d}.png")(folder) for k in (0, 1, 2, 4, 5)],
    "all test frames are absent": gone("masks/000003.png"),
}  # fmt: skip
PICTURES = {
    "a frame is cut": cut("frames/000002.png"),
    "a frame is empty": text("frames/000002.png", ""),
    "a frame is a folder": lambda folder: (gone("frames/000002.png")(folder),
                                           a_folder("frames/000002.png")(folder)),
    "a frame is of another size": picture("frames/000002.png", (50, 48)),
    "a frame is of one pixel": picture("frames/000002.png", (1, 1)),
    "a frame is grey": picture("frames/000002.png", mode="L"),
    "a frame is of 16 bits": picture("frames/000002.png", mode="I;16"),
    "a frame has alpha": picture("frames/000002.png", mode="RGBA", value=(9, 9, 9, 9)),
    "a frame has a palette": picture("frames/000002.png", mode="P"),
    "a frame is a .gif": picture("frames/000002.png", form="GIF"),
    "a frame is a .jpg": picture("frames/000002.png", form="JPEG"),
    "a frame claims 100,000 pixels a side": text("frames/000002.png", claims(100_000, 100_000)),
    "a frame claims no pixel": text("frames/000002.png", claims(0, 0)),
    "a frame is text": text("frames/000002.png", "picture"),
    "a frame is a link to itself": loop("frames/000002.png"),
    "a frame is a link to nowhere": lambda folder: (
        gone("frames/000002.png")(folder),
        os.symlink("/nowhere/a.png", folder / "frames/000002.png")),
    "a frame is missing": gone("frames/000002.png"),
    "the first frame is missing": gone("frames/000000.png"),
    "the last frame is missing": gone("frames/000005.png"),
    "a frame is named otherwise": moved("frames/000002.png", "frames/frame2.png"),
    "a frame has a number of ten digits": moved("frames/000002.png", "frames/9999999999.png"),
    "a frame has the last number of six digits": moved("frames/000002.png", "frames/999999.png"),
    "a frame has no Latin number": moved("frames/000002.png", "frames/٠٠٠٠٠٢.png"),
    "no frame": lambda folder: [p.unlink() for p in (folder / "frames").iterdir()],
    "frames are missing": gone("frames"),
    "frames are a file": lambda folder: (gone("frames")(folder), text("frames", "x")(folder)),
    "one frame alone": lambda folder: [
        p.unlink() for p in (folder / "frames").iterdir() if p.stem != "000000"],
    "the film is text": lambda folder: (gone("frames")(folder), text("video.mp4", "x")(folder)),
    "the film is empty": lambda folder: (gone("frames")(folder), text("video.mp4", "")(folder)),
    "the film is a folder": lambda folder: (gone("frames")(folder), a_folder("video.mp4")(folder)),
}  # fmt: skip
MASKS = {
    "a mask is cut": cut("masks/000002.png"),
    "a mask is empty": text("masks/000002.png", ""),
    "a mask is of another size": picture("masks/000002.png", (47, 48), "L"),
    "a mask is of colours": picture("masks/000002.png"),
    "a mask is of 16 bits": picture("masks/000002.png", mode="I;16", value=65535),
    "a mask has a palette": picture("masks/000002.png", mode="P", value=1),
    "a mask is of one bit": picture("masks/000002.png", mode="1", value=1),
    "a mask is black": picture("masks/000002.png", mode="L", value=0),
    "a mask is white": picture("masks/000002.png", mode="L", value=255),
    "a mask claims 100,000 pixels a side": text("masks/000002.png", claims(100_000, 100_000)),
    "a mask is missing": gone("masks/000002.png"),
    "a mask is a .npy of text": to_npy(2, lambda x: x.astype(str)),
    "a mask is a .npy of NaN": to_npy(2, lambda x: x * NAN),
    "a mask is a .npy of objects": to_npy(2, lambda x: np.array([{}], object)),
    "a mask is a .npy of 255": to_npy(2, lambda x: 255 * x),
    "a mask is a .npy of negatives": to_npy(2, lambda x: -x),
    "a mask is a .npy of three axes": to_npy(2, lambda x: x[..., None]),
    "a mask is a .npy of none": to_npy(2, lambda x: x[:0]),
    "a mask is a .npy that is an .npz": lambda folder: (
        gone("masks/000002.png")(folder),
        shutil.copy(folder / "cameras.npz", folder / "masks/000002.npy")),
    "masks are missing": gone("masks"),
    "masks are a file": lambda folder: (gone("masks")(folder), text("masks", "x")(folder)),
    "masks are inverted": each_mask(lambda x: 255 - x),
    "masks are of zero and one": each_mask(lambda x: x // 255),
    "masks are all white": each_mask(lambda x: 0 * x + 255),
    "masks are all black": each_mask(lambda x: 0 * x),
    "masks are of one pixel": each_mask(lambda x: np.pad(
        np.full((1, 1), 255, np.uint8), ((20, 27), (20, 27)))),
    "masks lie upside down": each_mask(lambda x: x[::-1].copy()),
}  # fmt: skip
NORMALS = {
    "normals of one frame, cut": lambda folder: (
        text("normals/000000.png", (folder / "frames/000000.png").read_bytes()[:90])(folder)),
    "normals of another size": lambda folder: (
        (folder / "normals").mkdir(), picture("normals/000000.png", (9, 9))(folder)),
    "normals of zero length": lambda folder: (
        (folder / "normals").mkdir(),
        np.save(folder / "normals/000000.npy", np.zeros((48, 48, 3), np.float32))),
    "normals of NaN": lambda folder: (
        (folder / "normals").mkdir(),
        np.save(folder / "normals/000000.npy", np.full((48, 48, 3), NAN, np.float32))),
    "normals of a thousand": lambda folder: (
        (folder / "normals").mkdir(),
        np.save(folder / "normals/000000.npy", np.full((48, 48, 3), 1000, np.float32))),
    "normals.json without normals": text("normals.json", '{"convention": "icon"}'),
    "normals are a file": text("normals", "x"),
    **{
        f"normals.json says {said[:30]}": lambda folder, said=said: (
            (folder / "normals").mkdir(), picture("normals/000000.png")(folder),
            text("normals.json", said)(folder))
        for said in (
            "{", "[]", "3", '{"convention": "mine"}', '{"convention": 3}',
            '{"convention": "icon"}', '{"convention": "icon", "boxes": []}',
            '{"convention": "icon", "boxes": [[0, 0]]}',
            '{"convention": "icon", "boxes": [[0, 0, -5, 5], 3]}',
            '{"convention": "icon", "boxes": [[0, 0, NaN, 48]]}',
            '{"convention": "icon", "boxes": [[0, 0, 1e300, 48]]}',
        )
    },
}  # fmt: skip
RECORDS = {
    f"{name} says {said[:24]}": text(name, said)
    for name in ("prepare.json", "synth.json", "refinement.json", "noise.json")
    for said in ("", "{", "[]", "null", '{"body": 3}', '{"body": {"vertices": "x"}}',
                 '{"figures": {"iou": "x", "iou_stage1": 1}}', "[" * 100_000)
}  # fmt: skip
TRUTH = {
    "truth is empty": a_folder("truth"),
    "truth is a file": text("truth", "x"),
    "truth without cameras": lambda folder: (
        a_folder("truth")(folder), shutil.copy(folder / "poses.npz", folder / "truth")),
    "truth of another length": lambda folder: (
        a_folder("truth")(folder),
        np.savez(folder / "truth/poses.npz", **{
            k: x[:4] if x.ndim > 1 else x for k, x in arrays(folder / "poses.npz").items()}),
        shutil.copy(folder / "cameras.npz", folder / "truth")),
    "truth of text": text("truth/poses.npz", "x"),
    "views is empty": a_folder("views"),
    "views say nothing": text("views/views.json", "{}"),
    "views of a frame that is not there": text("views/views.json", '{"frames": [77]}'),
    "poses_refined.npz is cut": lambda folder: (
        shutil.copy(folder / "poses.npz", folder / "poses_refined.npz"),
        cut("poses_refined.npz")(folder)),
    "poses_refined.npz is a folder": a_folder("poses_refined.npz"),
    "poses_refined.npz is of another length": lambda folder: np.savez(
        folder / "poses_refined.npz", **{
            k: x[:4] if x.ndim > 1 else x for k, x in arrays(folder / "poses.npz").items()}),
}  # fmt: skip
SUBJECTS = CAMERAS | POSES | SPLITS | PICTURES | MASKS | NORMALS | RECORDS | TRUTH
