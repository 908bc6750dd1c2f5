"""What landmarks say of poses, for both stages.

======================  ==============================================================
``rig``                 where landmarks sit on the body
``landmark_noise``      how far off landmarks are, and how many frames count as one
``swaps``               fixes frames in which left and right were swapped
======================  ==============================================================
"""
