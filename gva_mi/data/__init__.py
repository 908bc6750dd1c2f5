"""The folder format of a video, and everything that is read from it.

==================  ================================================================
``folder``          the names of the files and their one writer
``video``           ``Video`` and ``Frame``: the folder, opened and checked
``cameras``         ``cameras.npz``
``splits``          train and test frames
``pictures``        8-bit pictures and films on disk (``film``: in any order)
``film_pictures``   a film's pictures at an even rate (``film_colors``: as sRGB)
``masks``           masks as segmenters write them (``mattes``: of pictures)
``normals``         normal maps as networks write them
``landmarks``       named points of a person in every frame
``backdrop``        the person without the background
``crop``            a frame's part around the person, shrunk
``joints``          a posed body's joints in the world, a picture and a mask
``views``           what other cameras saw, for evaluation
``check``           what is wrong with a folder (``problems``, ``silhouettes``)
``ground_truth``    ground truth of a synthetic video
``fingerprint``     whether a subject is used with its own body
``networks/``       networks that see a person in pictures
``matting/``        masks of a film that hold at the person's outline
``importers/``      reads what other programs wrote
==================  ================================================================

Readers raise InputError, one sentence that names the file, the fault and the expected form.
"""
