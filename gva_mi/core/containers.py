"""Name files that are not read here for what they are, with what to do: :func:`known_container`."""

from __future__ import annotations

from pathlib import Path

# By the first bytes of a file.
_BEGINNINGS = {
    b"version https://git-lfs": "a Git LFS pointer instead of the file: git lfs pull fetches it",
    **dict.fromkeys(
        (b"<!DOCTYPE", b"<!doctype", b"<html"),
        "a web page, such as of a download that asks for an account",
    ),
    b"Kaydara FBX": "an .fbx, a scene: export its skeleton's motion as .bvh",
    b"HIERARCHY": "a .bvh, the motion of a skeleton of its own",
    b"\x89HDF": "an HDF5 file (.h5, .hdf5, .mat of version 7.3): save its arrays as .npz",
    b"MATLAB 5.0": "a .mat: scipy.io.loadmat reads it, numpy.savez saves its arrays",
    b"glTF": "a .glb, a scene: export its skeleton's motion as .bvh",
    b"; FBX": "an .fbx, a scene: export its skeleton's motion as .bvh",
    b"7z\xbc\xaf": "a .7z archive: unpack it",
    b"Rar!": "a .rar archive: unpack it",
    **dict.fromkeys((b"ply\n", b"ply\r\n"), "a .ply, points or a mesh"),
}  # fmt: skip
# By the suffix, where the beginning says nothing.
_SUFFIXES = {
    ".json": "a .json file: save its arrays by name as .npz",
    ".bvh": "a .bvh, the motion of a skeleton of its own",
    ".fbx": "an .fbx, a scene: export its skeleton's motion as .bvh",
    ".ksplat": "a .ksplat, a splat packed by GaussianSplats3D: save it as .ply, .splat or .spz",
    ".sog": "a .sog, a splat packed by PlayCanvas: save it as .ply",
    ".c3d": "a .c3d, markers without a body: fit a body to them, as MoSh does",
    ".blend": "a .blend, a scene: export the skeleton's motion as .bvh",
    ".usd": "a .usd, a scene: export the skeleton's motion as .bvh",
    ".tar": "a .tar archive: unpack it", ".tgz": "a .tgz archive: unpack it",
    ".csv": "a .csv table: save its columns as .npz", ".txt": "a text: save its numbers as .npz",
    ".safetensors": "a .safetensors file: save its arrays as .npz", ".onnx": "a network (.onnx)",
    **dict.fromkeys((".mp4", ".mov", ".avi", ".mkv", ".webm", ".gif"), "a film"),
    **dict.fromkeys((".png", ".jpg", ".jpeg"), "a picture"),
}  # fmt: skip


def known_container(path: Path) -> str | None:
    """Return what a file is and what to do with it, if it is a known kind that is not read here."""
    with path.open("rb") as file:
        start = file.read(64)
    found = (text for known, text in _BEGINNINGS.items() if start.startswith(known))
    return next(found, _SUFFIXES.get(path.suffix.lower()))
