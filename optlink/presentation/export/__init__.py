"""Export of designs as DXF, SVG, CSV, JSON and MJCF."""
