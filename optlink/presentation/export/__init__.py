"""Export of designs as DXF, SVG, CSV and JSON."""
