"""What can go wrong for the user, in one line that names the thing, the place and the mending.

The command line prints `error: <message>` and ends with exit code 3 for each of these; anything else that escapes is a bug.
"""


class MillcalError(Exception):
    """The input cannot be used. The message reads `<file or key>: <what is wrong>; <what to do>`."""


class RecordingError(MillcalError):
    """A recording cannot be read, or does not hold what is asked of it."""


class RecipeError(MillcalError):
    """A recipe or a setup says something that cannot be done."""


class IllPosedError(MillcalError):
    """The data cannot determine what is asked of them."""
