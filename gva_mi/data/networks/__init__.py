"""Networks that people bring, as files of their own: none is shipped or fetched.

====================  ==================================================================
``segment_anything``  the person's mask, from Segment Anything and where the pose is
``sam_weights``       the files that Segment Anything's weights come in
``normals``           the person's normals, from a TorchScript or an ONNX file
``crop``              the person cut out for a network, and its answer put back
====================  ==================================================================
"""
