"""Other people's pickles, read without running any code.

A pickle is a program: it names functions and calls them. Here its opcodes are walked by
``machine``, and a name means what the table ``meanings.NAMES`` says, or the file is refused by that
name. Nothing is ever imported, and none of the functions a file names is ever called: arrays are
cut from the file's own bytes, so that a size that is merely claimed allocates nothing.

==================  ================================================================
``reader``          ``read_objects``: which container a file is, from .pkl to .npz
``machine``         the opcodes; who may be called, filled, used as a key
``meanings``        what names stand for: arrays, sparse matrices, chumpy's arrays
``tensors``         torch's tensors and storages, as arrays; CUDA's too
==================  ================================================================
"""
