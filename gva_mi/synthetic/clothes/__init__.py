"""Clothes, hair and accessories as level sets (``level_sets``), bound to the body (``dressing``)."""
