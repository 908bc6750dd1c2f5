"""The masks choose the person: whose joints lie in them, and not who is seen longest."""

import numpy as np
import pytest

from gva_mi import InputError
from gva_mi.body.smplx import load_body
from gva_mi.data.importers.lens import centred
from gva_mi.data.importers.people import Votes, choose, joints_in_masks
from gva_mi.data.importers.tracks import Track

SIZE = (64, 48)
PELVIS = np.zeros(3)


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


def votes(tracks, cut_outs, joints, first=0):
    return joints_in_masks(tracks, cut_outs, first, joints)


def cut_outs(count, left, right):
    found = np.zeros((count, SIZE[1], SIZE[0]), np.uint8)
    found[:, :, left:right] = 255
    return found


def test_who_is_in_the_masks_wins_over_who_is_seen_longest(joints):
    short, long = track("short", 0.6, range(3)), track("long", -0.6, range(9))
    there = cut_outs(9, 32, 64)  # the right half of every picture
    found = votes([long, short], there, joints)
    assert found[1].share > 0.9 and found[0].share < 0.1
    chosen, notes = choose("x.pkl", [long, short], None, lambda: found)
    assert chosen is short
    assert "person short, most inside the masks, of long (9 frames, " in notes[0]


def test_a_passer_by_who_is_sometimes_inside_loses(joints):
    right, by = track("right", 0.6, range(6)), track("by", 0.0, range(9))
    found = votes([by, right], cut_outs(9, 32, 64), joints)
    assert 0.2 < found[0].share < 0.8
    assert choose("x.pkl", [by, right], None, lambda: found)[0] is right


def test_without_anybody_in_the_masks_the_longest_is_taken(joints):
    tracks = [track("a", -0.6, range(2)), track("b", -0.7, range(5))]
    for empty in (cut_outs(5, 32, 64), cut_outs(5, 0, 0)):
        found = votes(tracks, empty, joints)
        chosen, notes = choose("x.pkl", tracks, None, lambda found=found: found)
        assert chosen.person == "b" and "seen longest" in notes[0] and "nobody" in notes[0]
    assert found == [Votes(0, 0), Votes(0, 0)]  # an empty mask says nothing


def test_what_cannot_be_in_a_mask_has_no_vote(joints):
    behind, beside = track("behind", 0.0, [0], z=-4.0), track("beside", 50.0, [0])
    nothing = track("nothing", np.nan, [0])
    full = cut_outs(1, 0, 64)
    assert votes([behind, beside, nothing], full, joints) == [Votes(0, 0)] * 3


def test_the_estimators_numbers_may_start_at_another_one(joints):
    one = track("one", 0.6, [1])
    there = np.concatenate([cut_outs(1, 32, 64), cut_outs(1, 0, 32)])
    assert votes([one], there, joints, first=1)[0].share > 0.9
    assert votes([one], there, joints, first=0)[0].share < 0.1


def test_a_name_decides_and_the_masks_are_not_read():
    def never():
        raise AssertionError

    tracks = [track("a", 0.0, [0]), track("b", 0.0, [0])]
    assert choose("x.pkl", tracks, "b", never)[0] is tracks[1]
    assert choose("x.pkl", tracks[:1], None, never) == (tracks[0], [])
    with pytest.raises(InputError, match="has no person 'c'"):
        choose("x.pkl", tracks, "c", never)
