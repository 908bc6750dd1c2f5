"""What every other package uses: errors, files, options, workers and settings of the CPU.

===============  ===================================================================
``errors``       ``InputError``, the one error that a user can cause
``files``        arrays and JSON, read with one clear error; room for output
``atomic``       files and folders written whole or not at all; locks of folders
``options``      options as dataclasses, with the range of each number beside its type
``stamp``        result stamps: hashes of all that a result depends on
``console``      console output and the progress bar
``tasks``        independent tasks, in this process or in workers
``cpu``          the same bits on every CPU; cores shared by torch and Dr.Jit
``llvm``         the libLLVM that Dr.Jit loads
``pickles``      files of other programs, read without running their code
``spill_cache``  a cache in memory, then on disk
``srgb``         the transfer function of sRGB
===============  ===================================================================
"""
