"""Benchmarks of a checkout: ``gva-mi bench splat|growth|fit|table``."""
