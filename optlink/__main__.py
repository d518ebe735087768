"""`python -m optlink`, the same as the `optlink` command."""

from optlink.cli.app import main

if __name__ == "__main__":
    main()
