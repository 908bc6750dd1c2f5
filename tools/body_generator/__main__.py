"""Rebuild the file of the built-in body: ``python -m tools.body_generator``."""

from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.core.files import write_arrays
from tools.body_generator import generate

if __name__ == "__main__":
    write_arrays(BUILT_IN_BODY, **generate())
