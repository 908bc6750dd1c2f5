"""Stage 1 of a film: poses, shape and camera from a network's landmarks."""
