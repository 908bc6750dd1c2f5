"""Bridge between Dr.Jit and torch.

* ``exclusive.py``: the lock, because Dr.Jit's frozen functions are not made for threads;
* ``frozen.py``: kernels that are traced once and replayed;
* ``packets.py``: records in memory as rows of floats;
* ``tensors.py``: torch's tensors and Dr.Jit's arrays in the same memory;
* ``rowwise.py``: a kernel over the rows of tensors;
* ``not_compiled.py``: functions that ``torch.compile`` must not trace.
"""
