"""A synthetic person, from its shape and outfit to one coloured surface that moves with the body.

==================  ===============================================================
``identity``        the person: shape, colours, cut of clothes and hair
``bodies``          the body below the clothes; a body of other proportions
``level_sets``      closed surfaces around a body
``garments, hair``  clothes and hair as such surfaces
``dressing``        which of them a person wears, and how they follow the body
``surface``         skin, clothes and hair as one surface, with folds
``texture``         colours of skin, cloth and hair
==================  ===============================================================
"""
