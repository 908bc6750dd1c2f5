"""What joins Dr.Jit and torch: frozen functions, packets of rows, the lock, row-wise kernels."""
