"""Bridge between Dr.Jit and torch.

============  ======================================================================
``frozen``    kernels that are traced once and replayed, and the lock around them
``packets``   records in memory as rows of floats
``tensors``   torch's tensors and Dr.Jit's arrays in the same memory
``rowwise``   a kernel over the rows of tensors
============  ======================================================================
"""
