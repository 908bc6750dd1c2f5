"""Read other people's pickles without running any code of theirs: :func:`reader.read_objects`."""
