"""The command line."""

import os

DEBUG = "OPTLINK_DEBUG"
"""Environment variable; if it is not empty, the traceback of an unexpected exception is printed."""
FAULT = 4
"""Exit code of an unexpected exception, which is a fault of optlink."""


def traced(error: BaseException) -> str:
    """Print the traceback of an exception on request; return where it is, or how to get it."""
    if not os.environ.get(DEBUG):
        return f"{DEBUG}=1 prints the traceback"
    import traceback

    traceback.print_exception(error)
    return "the traceback is above"
