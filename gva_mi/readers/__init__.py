"""Read files of other programs: pose estimators, data sets, masks, keypoints, motions.

**Another pose estimator is a record in ``estimators``**; its docstring is the recipe. Another data
set is a record in ``datasets``.

Into a subject's folder, for ``gva-mi prepare``:

=====================  =============================================================
``prepare``            writes the folder: start here
``estimators``         the table of pose estimators
``estimator_layouts``  how their files hold people, and the lens that each assumes
``datasets``           the table of data sets
``people``             the choice of the subject among several people
``own_masks``          masks and normals that a user provides
``keypoints``          keypoints of other networks, as landmarks
=====================  =============================================================

Into poses that drive an avatar, for ``gva-mi motion``:

=====================  =============================================================
``motions``            AMASS, MoSh++, AIST++ and estimators' files: start here
``bvh``                BVH files, which ``retarget`` converts to the body
``joint_motions``      joint positions without rotations: HumanML3D
``up_axis``            which axis of a motion is up
=====================  =============================================================

For both:

=====================  =============================================================
``source_files``       a user's file or folder, opened
``body_arrays``        the table of names under which programs write a body's arrays
``track``              ``Track``: one person, frame by frame, as a camera sees them
``target_body``        ``TargetBody``: the body that poses are converted to
=====================  =============================================================
"""
