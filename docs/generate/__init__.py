"""The parts of the documentation that are made from the program, and stored in the pages as plain Markdown."""
