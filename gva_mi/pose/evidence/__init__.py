"""Evidence about poses from images: masks, normals, close-ups of hands and feet, landmarks."""
