"""Benchmarks of a checkout: ``python -m benchmarks splat|fit|mesh|viewer``."""
