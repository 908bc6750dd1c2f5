"""The folder of one person's video: its files, the reader, the writer, and the check.

Start with ``folder`` (which file holds what), ``video`` (read them) and ``opened`` (for a step).

==================  ================================================================
``folder``          names of the files, and ``SubjectWriter``, which writes them
``video``           ``Video`` and ``Frame``: ``load_video`` reads and validates a folder
``opened``          ``open_subject``: video, poses and body for a step
``check``           ``gva-mi check``: everything wrong with a folder
``problems``        ``Problem`` and ``CheckReport``, what a check finds
``silhouettes``     the posed body compared with the masks
==================  ================================================================

One file format each:

==================  ================================================================
``pictures``        8-bit pictures on disk, also as masks
``video_file``      video files: any picture as sRGB; writing mp4
``footage``         pictures and masks that a user names: files, folders or arrays; the
                    numbers in their names
``masks``           masks as segmentation programs write them
``normals``         normal maps as networks write them
``cameras``         ``cameras.npz``
``landmarks``       ``landmarks.npz``: named points of a person in every frame
``splits``          ``splits.json``: train and test frames
``fingerprint``     ``prepare.json``, ``synth.json``: the body that a subject is for
``ground_truth``    ``truth/`` and ``views/``, for evaluation alone
==================  ================================================================

Geometry of pictures:

==================  ================================================================
``lens``            focal lengths: assumed, recorded or given; distortion
``crop``            the part of a frame around the person, shrunk
``backdrop``        the background's colour removed from the person's outline
==================  ================================================================

Poses are read by ``gva_mi.body.pose``. Readers raise an InputError, one sentence that names the
file, the fault and the expected form.
"""
