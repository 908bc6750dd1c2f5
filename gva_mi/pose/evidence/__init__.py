"""Evidence about poses from images: masks and normals of the person, close-ups of hands and
feet."""
