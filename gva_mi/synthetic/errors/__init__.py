"""Errors of the estimates that come with a synthetic video, as a real pipeline makes them.

=====================  ==========================================================
``models``             error models: distributions over all errors of a video
``closest_pose``       the ground truth on the fitted body, which errors start from
``poses``              errors of poses and camera
``masks_and_normals``  errors of masks and normals
``pipeline``           the estimates of a video, written to its folder
=====================  ==========================================================
"""
