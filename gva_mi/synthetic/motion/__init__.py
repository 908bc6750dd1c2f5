"""Motions of a synthetic person.

=============  ====================================================================
``motions``    the motions of a video, and held-out poses
``actions``    squats, steps, and gestures with the arms, which motions blend in
``footwork``   feet that do not slide, and legs that reach for them
=============  ====================================================================
"""
