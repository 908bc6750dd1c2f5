"""The seven subjects of the study, and outfits."""

import itertools

import numpy as np

from gva_mi.synthetic.people import STUDY


def test_the_seven_subjects_differ_and_cover_the_hard_cases():
    assert len({person.seed for person in STUDY.values()}) == 7
    for a, b in itertools.combinations(STUDY.values(), 2):
        assert np.abs(np.subtract(a.betas, b.betas)).max() > 0.5
        assert a.top != b.top and a.outfit != b.outfit
    wardrobes = [person.outfit for person in STUDY.values()]
    assert {w.hair for w in wardrobes} == {"short", "bob", "long"}
    assert {w.bottom for w in wardrobes} == {"trousers", "shorts", "skirt"}
    assert sum(w.glasses for w in wardrobes) == 1 and sum(w.cap for w in wardrobes) == 1
