"""Read files of other programs: motions, pose estimators, data sets, films and masks.

======================  ============================================================
``spellings``           names under which programs write a body's arrays
``fields``              a body's arrays of any names and shapes
``joint_rotations``     rotations of joints in any public shape
``tracks``              one person, frame by frame, in a camera's axes
``people``              choice of the subject among several people
``numbering``           frame numbers
``world``               which axis is up
``one_lens``            places seen through another lens in each frame
``lens``                focal lengths: assumed, recorded (``quicktime``), or given;
                        distortion
``estimators``          one record for each pose estimator; the readers of their files
                        are ``estimator_files``, ``people_files``, ``frame_files``
``hands``               hands of a hand estimator, which ``hand_merge`` puts in
``keypoints``           keypoints of other networks, as landmarks
``motions``             AMASS (``mosh``), AIST++ and what estimators saw, as driving
                        poses; ``frame_rate``: frames a second
``joint_motion``        motions of joints without rotations, posed by ``joint_fit``
``bvh``                 motion capture, which ``retarget`` turns into poses by the
                        joints that ``humanoid`` finds
``capture``             people with their pictures, masks and splits
``datasets``            one record for each data set (``one_camera``, ``multi_view``)
``other_views``         a data set's other cameras, held out
``footage``             pictures and masks of films, folders and arrays
``normal_maps``         normals of another program
``prompts``             boxes and points on the person, for Segment Anything
``by_networks``         masks and normals by networks
``target``              the body that poses are converted to
``prepare``             writes a subject's folder from these (``prepare_options``)
======================  ============================================================
"""
