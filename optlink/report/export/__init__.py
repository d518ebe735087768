"""Designs for other programs: DXF, SVG, CSV, JSON."""
