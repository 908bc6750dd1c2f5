"""The folder format of a video, and everything that is read from it.

==================  ================================================================
``folder``          the names of the files and their one writer
``video``           ``Video`` and ``Frame``: the folder, opened and checked
``cameras``         ``cameras.npz``
``splits``          train and test frames
``pictures``        8-bit pictures on disk, also as masks
``film``            films: any of their pictures, as sRGB; how they are written
``film_pictures``   a film's pictures at an even rate
``masks``           masks as segmenters write them
``normals``         normal maps as networks write them
``landmarks``       named points of a person in every frame
``backdrop``        the person without the background
``crop``            a frame's part around the person, shrunk
``check``           what is wrong with a folder (``problems``, ``silhouettes``)
``ground_truth``    ground truth of a synthetic video, and held-out views
``fingerprint``     whether a subject is used with its own body
``networks/``       networks that see a person in pictures
``matting/``        masks of a film that hold at the person's outline
``importers/``      reads what other programs wrote
==================  ================================================================

Readers raise InputError, one sentence that names the file, the fault and the expected form.
"""
