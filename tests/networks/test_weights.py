"""The networks' files: where they are looked for, fetched and checked."""

import hashlib
import sys
import zipfile

import pytest

from gva_mi.core.errors import InputError
from gva_mi.networks import mediapipe
from gva_mi.networks.mediapipe import TfliteNetwork, weights_file

MODULES = {  # of the wheel: the folder of each file
    "pose_detection.tflite": "pose_detection", "pose_landmark_full.tflite": "pose_landmark",
    "hand_landmark_full.tflite": "hand_landmark", "face_landmark.tflite": "face_landmark",
}  # fmt: skip
NAMES = list(mediapipe._SHA256)


@pytest.fixture
def offline(monkeypatch):
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", "")


@pytest.fixture
def small_wheel(tmp_path, monkeypatch):
    """A wheel of mediapipe that pip finds, with files of a few bytes, and their hashes."""
    files = {name: name.encode() for name in NAMES}
    folder = tmp_path / "wheels"
    folder.mkdir()
    version = mediapipe.MEDIAPIPE_VERSION
    path = folder / f"mediapipe-{version}-cp311-cp311-manylinux_2_28_x86_64.whl"
    about = f"mediapipe-{version}.dist-info"
    with zipfile.ZipFile(path, "w") as wheel:
        for name in NAMES:
            wheel.writestr(f"mediapipe/modules/{MODULES[name]}/{name}", files[name])
        wheel.writestr(f"{about}/LICENSE", "Apache License")
        wheel.writestr(
            f"{about}/METADATA", f"Metadata-Version: 2.1\nName: mediapipe\nVersion: {version}\n"
        )
        wheel.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: false\n")
    hashed = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    monkeypatch.setattr(mediapipe, "_SHA256", hashed)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(folder))
    return path


def test_missing_files_are_fetched_once_with_licence_and_notice(small_wheel, tmp_path, monkeypatch):
    monkeypatch.delenv(mediapipe.WEIGHTS_VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / f"cache/gva_mi/mediapipe-{mediapipe.MEDIAPIPE_VERSION}"
    assert weights_file(NAMES[0]) == folder / NAMES[0]
    assert {path.name for path in folder.iterdir()} == {*NAMES, "LICENSE", "NOTICE"}
    assert "Apache License" in (folder / "LICENSE").read_text()
    assert "Apache License 2.0" in (folder / "NOTICE").read_text()
    small_wheel.unlink()
    assert all(weights_file(name).read_text() == name for name in NAMES)


def test_without_files_and_network_one_sentence_says_what_to_do(offline, tmp_path, monkeypatch):
    (tmp_path / "empty").mkdir()
    monkeypatch.setenv(mediapipe.WEIGHTS_VARIABLE, str(tmp_path / "empty"))
    with pytest.raises(InputError, match="pip cannot fetch them .*set GVA_MI_WEIGHTS") as error:
        weights_file(NAMES[0])
    assert NAMES[0] in str(error.value)
    assert not list((tmp_path / "empty").iterdir())


def test_a_mistyped_folder_is_not_made(small_wheel, tmp_path, monkeypatch):
    monkeypatch.setenv(mediapipe.WEIGHTS_VARIABLE, str(tmp_path / "mistyped"))
    with pytest.raises(InputError, match="mistyped: no such folder; expected the folder"):
        weights_file(NAMES[0])
    assert not (tmp_path / "mistyped").exists()


def test_another_file_than_expected_is_refused(small_wheel, tmp_path, monkeypatch):
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    monkeypatch.setenv(mediapipe.WEIGHTS_VARIABLE, str(tmp_path / "here"))
    path = weights_file(NAMES[0])
    path.write_bytes(b"another network")
    with pytest.raises(InputError, match="is not MediaPipe's file .*delete it"):
        weights_file(NAMES[0])
    monkeypatch.setitem(mediapipe._SHA256, NAMES[0], "0" * 64)
    monkeypatch.setenv(mediapipe.WEIGHTS_VARIABLE, str(tmp_path / "there"))
    with pytest.raises(InputError, match="is not MediaPipe's file"):  # fetched, and not kept
        weights_file(NAMES[0])
    assert not list((tmp_path / "there").glob("*.tflite"))


def test_a_missing_package_and_a_damaged_file_are_sentences(tmp_path, monkeypatch):
    path = tmp_path / "network.tflite"
    path.write_bytes(b"no network")
    with pytest.raises(InputError, match="no readable .tflite"):
        TfliteNetwork(path)
    monkeypatch.setitem(sys.modules, "ai_edge_litert.interpreter", None)
    with pytest.raises(InputError, match=r"pip install 'gva_mi\[video\]'"):
        TfliteNetwork(path)
