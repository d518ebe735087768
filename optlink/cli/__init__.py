"""The command line."""

DEBUG = "OPTLINK_DEBUG"
"""Environment variable; if it is not empty, the traceback of an unexpected exception is printed."""
FAULT = 4
"""Exit code of an unexpected exception, which is a fault of optlink."""
