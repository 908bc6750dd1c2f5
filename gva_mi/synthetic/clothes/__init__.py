"""Clothes, hair and accessories of synthetic subjects, and how they follow the body.

==================  ================================================================
``level_sets``      closed surfaces as level sets around a body, used by all others
``garments``        shirts, trousers, skirts, shoes
``hair``            short hair, a bob, long hair
``accessories``     glasses, caps, hoods, bags
``binding``         which vertices of the body a garment's vertices follow
``folds``           creases at bent joints, and loose ends that lag behind
``dressing``        puts it all on a body
==================  ================================================================
"""
