"""Bridge between Dr.Jit and torch.

* ``frozen.py``: kernels that are traced once and replayed, and the lock around them;
* ``packets.py``: records in memory as rows of floats;
* ``tensors.py``: torch's tensors and Dr.Jit's arrays in the same memory;
* ``rowwise.py``: a kernel over the rows of tensors.
"""
