"""The one error a user can cause: input that does not have the expected form."""


class InputError(ValueError):
    """A file, folder or option that cannot be used, in one sentence.

    The sentence names what was found, where, and which form was expected. The command line prints
    it and leaves with exit code 2; everything else is a bug and keeps its traceback.
    """
