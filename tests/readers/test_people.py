"""The subject is the person whose joints lie in the masks, not the person seen longest."""

import numpy as np
import pytest

from gva_mi import InputError
from gva_mi.body.smplx import load_body
from gva_mi.readers.people import choose, joints_in_masks
from gva_mi.readers.track import Track
from gva_mi.subject.lens import centred

SIZE = (64, 48)


def track(person, x, frames, z=4.0):
    """Somebody upright, ``x`` metres right of the camera's axis."""
    count = len(frames)
    rotations = np.zeros((count, 55, 3))
    rotations[:, 0, 0] = np.pi  # upright in the camera's axes
    transl = np.tile([x, 0.0, z], (count, 1))
    K = np.tile(centred(80.0, SIZE), (count, 1, 1))
    return Track(person, np.array(frames), rotations, transl, None, K, "SMPL", False)


@pytest.fixture(scope="module")
def joints():
    return load_body().j_template.view(-1, 3).double().numpy()


def share(pair):
    return pair[0] / pair.sum()


def cut_outs(count, left, right):
    found = np.zeros((count, SIZE[1], SIZE[0]), np.uint8)
    found[:, :, left:right] = 255
    return found


def test_the_person_in_the_masks_wins_over_the_person_seen_longest(joints):
    short, long = track("short", 0.6, range(6)), track("long", -0.6, range(9))
    by = track("by", 0.0, range(9))  # inside some frames
    found = joints_in_masks(
        [long, by, short], cut_outs(9, 32, 64), joints
    )  # the right half of each picture
    assert share(found[2]) > 0.9 and share(found[0]) < 0.1 and 0.2 < share(found[1]) < 0.8
    chosen, notes = choose("x.pkl", [long, by, short], None, lambda: found)
    assert chosen is short
    assert "person short, most inside the masks, of long (9 frames, " in notes[0]


def test_with_nobody_in_the_masks_the_person_seen_longest_is_taken(joints):
    tracks = [track("a", -0.6, range(2)), track("b", -0.7, range(5))]
    for empty in (cut_outs(5, 32, 64), cut_outs(5, 0, 0)):
        found = joints_in_masks(tracks, empty, joints)
        chosen, notes = choose("x.pkl", tracks, None, lambda found=found: found)
        assert (
            chosen.person == "b"
            and "seen longest" in notes[0]
            and "no person lies in the masks" in notes[0]
        )
    assert not found.any()  # an empty mask says nothing


def test_a_joint_behind_the_camera_or_beyond_the_border_has_no_vote(joints):
    behind, beside = track("behind", 0.0, [0], z=-4.0), track("beside", 50.0, [0])
    nothing = track("nothing", np.nan, [0])
    full = cut_outs(1, 0, 64)
    assert not joints_in_masks([behind, beside, nothing], full, joints).any()


def test_a_name_decides_without_reading_the_masks():
    def never():
        raise AssertionError

    tracks = [track("a", 0.0, [0]), track("b", 0.0, [0])]
    assert choose("x.pkl", tracks, "b", never)[0] is tracks[1]
    assert choose("x.pkl", tracks[:1], None, never) == (tracks[0], [])
    with pytest.raises(InputError, match="has no person 'c'"):
        choose("x.pkl", tracks, "c", never)
