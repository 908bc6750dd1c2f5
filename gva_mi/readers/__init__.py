"""Read files of other programs: motions, pose estimators, data sets, masks, keypoints.

===============  ===================================================================
``estimators``   the table of pose estimators: one record for each, and its reader
``body_arrays``  the table of a body's array names: poses, place and shape in a file
``track``        one person, frame by frame, before a camera; the body it is for
``people``       choice of the subject among several people, and where they are seen
``datasets``     one record for each data set
``own_masks``    masks of another program or by Segment Anything; normals by a network
``keypoints``    keypoints of other networks, as landmarks
``prepare``      writes a subject's folder from these
``motions``      AMASS, MoSh++, AIST++ and what estimators saw, as driving poses
``bvh``          motion capture, which ``retarget`` turns into poses
``joints``       motions of joints without rotations: HumanML3D
``world``        which axis is up
===============  ===================================================================
"""
