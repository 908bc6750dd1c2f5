"""What ``joblib.dump`` writes, by the form of its files: joblib itself is no dependency."""

import io
import pickle

import numpy as np


class NumpyArrayWrapper:
    """joblib's; under its module's name in the file."""

    def __init__(self, array):
        self.subclass, self.shape, self.dtype = np.ndarray, array.shape, array.dtype
        self.order = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
        self.allow_mmap, self.numpy_array_alignment_bytes = not array.dtype.hasobject, 16


NumpyArrayWrapper.__module__ = "joblib.numpy_pickle"


class JoblibPickler(pickle._Pickler):
    """Writes what ``joblib.dump`` writes: arrays' bytes behind their wrapper, aligned to 16."""

    def save(self, obj, *args, **options):
        if type(obj) is not np.ndarray:
            return super().save(obj, *args, **options)
        wrapper, file = NumpyArrayWrapper(obj), self.file
        super().save(wrapper)
        self.framer.commit_frame(force=True)
        if obj.dtype.hasobject:
            return pickle.dump(obj, file, protocol=5)
        padding = 16 - (file.tell() + 1) % 16
        file.write(bytes([padding]) + b"\xff" * padding + obj.tobytes(wrapper.order))

    def save_global(self, obj, name=None):
        if obj is not NumpyArrayWrapper:
            return super().save_global(obj, name)
        self.save("joblib.numpy_pickle")
        self.save("NumpyArrayWrapper")
        self.write(pickle.STACK_GLOBAL)

    dispatch = dict(pickle._Pickler.dispatch)
    dispatch[type] = lambda self, obj: self.save_global(obj)


def joblib_dump(value):
    file = io.BytesIO()
    pickler = JoblibPickler(file, protocol=4)
    pickler.file = file
    pickler.dump(value)
    return file.getvalue()
