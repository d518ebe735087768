"""Links as parts that can be cut or printed: their shapes, the layers in which they are stacked, solids."""
