"""Figures, tables and page sections for each kind of result."""
