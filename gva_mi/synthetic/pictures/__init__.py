"""Pictures of a synthetic person, on white or in a room.

===============  =======================================================
``cameras``      a camera on white; a phone that stands or is held
``room``         a room around the person, and the furniture in it
``finishes``     colours of walls, floors and furniture
``lights``       lamps and sky; the same for Mitsuba
``render``       rays and light: pictures, masks and normals
===============  =======================================================
"""
