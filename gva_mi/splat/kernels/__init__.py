"""The kernels of splatting, and what they are made of: Dr.Jit and numpy alone."""
