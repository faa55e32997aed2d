"""The one exception type that every error of this project derives from, and the check of settings that raises it."""


class VaporTrackError(Exception):
    """An input cannot be used; the message names what, where, what was found and what was expected."""


def require_within(settings: object, **ranges: tuple[int | float, int | float]) -> None:
    """Check numbers among the attributes of an object.

    Args:
        settings: The object.
        ranges: Name of an attribute -> its smallest and its largest value.

    Raises:
        VaporTrackError: one lies outside, or is NaN.
    """
    for name, (low, high) in ranges.items():
        value = getattr(settings, name)
        if not low <= value <= high:  # NaN compares as false
            raise VaporTrackError(f"{name} is {value}, expected between {low} and {high}")
