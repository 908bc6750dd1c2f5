"""Pictures of a synthetic person, on white or in a room.

===============  =======================================================
``cameras``      a camera on white; a phone that stands or is held
``room``         a room around the person
``furniture``    the pieces in it
``finishes``     colours of walls, floors and furniture
``render``       rays and light: pictures, masks and normals
===============  =======================================================
"""
