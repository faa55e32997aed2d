"""The one exception type that every error of this project derives from."""


class VaporTrackError(Exception):
    """An input cannot be used; the message names what, where, what was found and what was expected."""
