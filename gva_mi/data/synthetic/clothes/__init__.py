"""What a synthetic person wears, and how it moves with the body.

==================  ================================================================
``dressing``        dresses a body: which pieces, and how each hangs on it
``garments``        shirts, trousers, skirts, shoes
``hair``            short hair, a bob, long hair
``hoods``           a hood over the head or on the back
``accessories``     glasses and caps
``bags``            a backpack, a shoulder bag, and their straps
``level_sets``      closed surfaces as level sets around a body: what all of them are made with
``binding``         which vertices of the body a garment's vertices follow
``folds``           creases where cloth bends, and loose ends that lag behind
==================  ================================================================
"""
