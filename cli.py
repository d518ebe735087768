"""Launcher for a checkout without an install: `python cli.py solve crank-rocker`."""

from optlink.__main__ import main

if __name__ == "__main__":
    main()
