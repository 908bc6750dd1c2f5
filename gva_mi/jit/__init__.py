"""Where Dr.Jit and torch meet: kernels over the rows of torch tensors, usable by any layer."""
