"""Clothes, hair, accessories as level sets (``level_sets``), bound to a body (``dressing``)."""
