"""Networks that users bring as files of their own; none is shipped or downloaded.

====================  ==================================================================
``segment_anything``  the person's mask, by Segment Anything, prompted by the pose
``sam_weights``       reads Segment Anything's weights
``normals``           the person's normals, by a TorchScript or an ONNX file
``crop``              cuts the person out for a network
====================  ==================================================================
"""
