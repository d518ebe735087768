"""Strict reading of result files."""
