"""Networks that users bring as files of their own; none is shipped or downloaded.

====================  ==================================================================
``segment_anything``  the person's mask, by Segment Anything, prompted by the pose
``normals``           the person's normals, by an ONNX file
``crop``              cuts the person out for a network
====================  ==================================================================
"""
