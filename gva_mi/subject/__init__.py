"""The folder of one person's video: its files, their one reader and one writer, and its check.

==================  ================================================================
``folder``          the names of the files, and ``SubjectWriter``
``video``           ``Video`` and ``Frame``: the folder, opened and validated
``cameras``         ``cameras.npz``
``lens``            focal lengths: assumed, recorded or given; distortion
``splits``          train and test frames
``pictures``        8-bit pictures on disk, also as masks
``video_file``      files of videos: any picture, as sRGB; how they are written
``footage``         pictures, masks and frame numbers of files, folders and arrays
``masks``           masks as segmentation programs write them
``normals``         normal maps as networks write them
``landmarks``       named points of a person in every frame
``backdrop``        the person without the background
``crop``            a frame's part around the person, shrunk
``check``           what is wrong with a folder (``problems``, ``silhouettes``)
``ground_truth``    ground truth of a synthetic video, and held-out views
``fingerprint``     whether a subject is used with its own body
==================  ================================================================

Readers raise InputError, one sentence that names the file, the fault and the expected form.
"""
