"""Colours of the pictures, and the style of their figures, for pictures of your own beside them."""

from optlink.namespace import namespace

__all__, __getattr__, __dir__ = namespace(
    __name__,
    """
    optlink.presentation.style: BODIES COUPLER CRANK GROUND LIMIT MUTED RESULT ROCKER SHADE STYLE TARGET
    """,
)
