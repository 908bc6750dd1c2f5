"""A program's digest changes with its code, and with nothing else."""

from gva_mi.core.provenance import code_of, hash_arrays, program_digest


def test_comments_docstrings_and_layout_do_not_change_a_digest():
    plain = "def f(x):\n    return x + 1 if x in {'a', 'b'} else 2\n"
    told = '"""A module."""\n# why\n\ndef f(x):\n    """Add."""\n    return (x + 1\n'
    told += "            if x in {'a', 'b'} else 2)\n"
    assert code_of(plain) == code_of(told)
    for other in (plain.replace("1", "3"), plain.replace("+", "-"), plain.replace("'b'", "'c'")):
        assert code_of(plain) != code_of(other)
    assert len(program_digest()) == 16


def test_a_hash_of_arrays_sees_values_shapes_and_types():
    arrays = ([1.0, 2.0], "words")
    assert hash_arrays(arrays) == hash_arrays(iter(arrays))
    for other in (([1.0, 3.0], "words"), ([[1.0, 2.0]], "words"), ([1, 2], "words")):
        assert hash_arrays(other) != hash_arrays(arrays)
