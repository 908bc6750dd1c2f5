"""The folder format of a video, and everything that is read from it.

==================  ================================================================
``video``           ``Video`` and ``Frame``: the folder, opened and checked
``pictures``        8-bit pictures, arrays and films on disk
``masks``           masks as segmenters write them
``normals``         normal maps as networks write them
``truth``           what is true about a synthetic video, and on which body
``fingerprint``     whether a synthetic subject is used with its own body
``importers/``      reads what other programs wrote
``synthetic/``      makes such folders
==================  ================================================================
"""
